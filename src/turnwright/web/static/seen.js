/* Requests of surface maps, also ahead of the scene. */

import { postPacked } from "./api.js";
import { CLIENT } from "./dom.js";

const PIXELS = 288;
let ahead = null;

function ask(job, quantity) {
  const stop = new AbortController();
  return { job, quantity, stop, answer: postPacked("/view/surface", { data: job, quantity, pixels: PIXELS, client: CLIENT }, { signal: stop.signal }) };
}

/** Send the first request of the scene ahead. */
export function askAhead(job, quantity) {
  ahead?.stop.abort();
  ahead = ask(job, quantity);
  ahead.answer.catch(() => {}); // the error is handled where the answer is used
}

/** The surface map of a quantity. */
export function surfaceOf(job, quantity, signal) {
  const [before, known] = [ahead, ahead?.job === job && ahead.quantity === quantity];
  ahead = null;
  if (!known) before?.stop.abort();
  const { stop, answer } = known ? before : ask(job, quantity);
  signal.addEventListener("abort", () => stop.abort());
  return answer;
}
