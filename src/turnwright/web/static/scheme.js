/* Apply the chosen theme before the first paint, to avoid a flash of the other one. */

try {
  const chosen = localStorage.getItem("turnwright.theme");
  if (chosen) document.documentElement.dataset.theme = chosen;
} catch {
  // Without local storage the system setting applies.
}
