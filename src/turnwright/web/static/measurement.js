/* The measurement that is shown: load it, update it while it is processed, clear it. */

import { get } from "./api.js";
import { say, set } from "./state.js";

const POLL_MS = 700; // interval of updates while a measurement is processed
export const GOING = new Set(["queued", "running"]);

let timer = 0;
let wanted = null; // id of the last requested measurement

/** Stop the updates. */
export function halt() {
  clearTimeout(timer);
}

/** Clear the measurement and cancel a pending one. */
export function clear() {
  halt();
  wanted = null;
  set({ measurement: null });
}

/** Show a measurement, and update it while it is processed. */
export async function follow(id) {
  halt();
  wanted = id;
  try {
    const measurement = { id, ...(await get(`/measurements/${id}`)) };
    // Another one was chosen in the meantime.
    if (wanted !== id) return;
    set({ measurement });
    if (GOING.has(measurement.state)) timer = setTimeout(() => follow(id), POLL_MS);
    if (measurement.state === "failed") say(measurement.sentence ?? "The file could not be read.", "bad");
  } catch (error) {
    say(error.message, "bad");
  }
}
