/* Helpers of the views: elements, animation frames and the identifier of this page. */

/** Identifier of this page. */
export const CLIENT = `${Date.now().toString(36)}${Math.random().toString(36).slice(2, 10)}`;

/** Limit `call` to once per animation frame. */
export function framed(call) {
  let asked = false;
  return () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      call();
    });
  };
}

/** Make an element: element("button", {class: "tool", title: "…"}, children). */
export function element(kind, attributes = {}, children = []) {
  const made = document.createElement(kind);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value !== null && value !== undefined && value !== false) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...[children].flat());
  return made;
}
