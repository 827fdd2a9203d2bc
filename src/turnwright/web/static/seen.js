/* The part as the scene asks for it; also before the scene is there, so that one does not wait for the other. */

import { postPacked } from "./api.js";
import { CLIENT } from "./dom.js";

const PIXELS = 288;
let ahead = null;

function ask(job, quantity) {
  const stop = new AbortController();
  return { job, quantity, stop, answer: postPacked("/view/surface", { data: job, quantity, pixels: PIXELS, client: CLIENT }, { signal: stop.signal }) };
}

/** Ask what the scene will ask first. */
export function askAhead(job, quantity) {
  ahead?.stop.abort();
  ahead = ask(job, quantity);
  ahead.answer.catch(() => {}); // whoever takes the answer hears of it
}

/** The part in the colours of a quantity. */
export function surfaceOf(job, quantity, signal) {
  const [before, known] = [ahead, ahead?.job === job && ahead.quantity === quantity];
  ahead = null;
  if (!known) before?.stop.abort();
  const { stop, answer } = known ? before : ask(job, quantity);
  signal.addEventListener("abort", () => stop.abort());
  return answer;
}
