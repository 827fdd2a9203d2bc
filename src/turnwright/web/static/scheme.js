/* What the switch has chosen holds before anything is drawn: else a dark page would begin with a white one. */

try {
  const chosen = localStorage.getItem("turnwright.theme");
  if (chosen) document.documentElement.dataset.theme = chosen;
} catch {
  // A browser that keeps nothing follows the system.
}
