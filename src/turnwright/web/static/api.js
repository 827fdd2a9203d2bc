/* Requests to the server: JSON, packed arrays, events, files. Every failure is an ApiError with one sentence. */

export class ApiError extends Error {
  constructor(sentence, status) {
    super(sentence);
    this.status = status;
  }
}

/** The URL of a path below /api with a query. */
export function address(path, query = {}) {
  const given = Object.entries(query).filter(([, value]) => value !== undefined && value !== null);
  const text = new URLSearchParams(given.map(([key, value]) => [key, String(value)])).toString();
  return `/api${path}${text ? `?${text}` : ""}`;
}

/** Callback for a lost connection, set by app.js. */
export const reach = { lost: () => {} };

async function answer(path, options) {
  let response;
  try {
    response = await fetch(path, { credentials: "same-origin", cache: "no-store", ...options });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    reach.lost();
    throw new ApiError("The server does not answer: restart turnwright serve.", 0);
  }
  if (response.ok) return response;
  let sentence = `The server answered ${response.status}.`;
  try {
    const { detail } = await response.json();
    if (typeof detail === "string") sentence = detail;
  } catch {
    // Not JSON: keep the status code.
  }
  throw new ApiError(sentence, response.status);
}

function asked(body, signal, method) {
  if (body === undefined) return { signal, method };
  return { signal, method, body: JSON.stringify(body), headers: { "Content-Type": "application/json" } };
}

/** GET as JSON. */
export async function get(path, query, { signal } = {}) {
  return (await answer(address(path, query), asked(undefined, signal, "GET"))).json();
}

/** POST JSON, answer JSON. */
export async function post(path, body = {}, { signal } = {}) {
  return (await answer(address(path), asked(body, signal, "POST"))).json();
}

/** POST JSON, answer the bytes of a file. */
export async function postForFile(path, body) {
  return (await answer(address(path), asked(body, undefined, "POST"))).blob();
}

/** DELETE. */
export async function remove(path) {
  await answer(address(path), { method: "DELETE" });
}

/** Unpack a message: {header, arrays: {name: {data: Float32Array, shape}}}; nan is a missing value. */
export function unpack(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < 8 || view.getUint32(0) !== 0x54573031) {
    throw new ApiError("The server's answer is not a packed map: reload the page.", 0);
  }
  const length = view.getUint32(4, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
  const arrays = {};
  let at = 8 + length;
  for (const { name, shape } of header.arrays) {
    const count = shape.reduce((product, side) => product * side, 1);
    arrays[name] = { data: new Float32Array(buffer, at, count), shape };
    at += 4 * count;
  }
  return { header, arrays };
}

/** GET packed arrays. */
export async function getPacked(path, query, { signal } = {}) {
  return unpack(await (await answer(address(path, query), asked(undefined, signal, "GET"))).arrayBuffer());
}

/** POST JSON, answer packed arrays. */
export async function postPacked(path, body, { signal } = {}) {
  return unpack(await (await answer(address(path), asked(body, signal, "POST"))).arrayBuffer());
}

/** POST the bytes of a file, answer packed arrays. */
export async function sendForPacked(path, query, file) {
  const options = { method: "POST", body: file, headers: { "Content-Type": "application/octet-stream" } };
  return unpack(await (await answer(address(path, query), options)).arrayBuffer());
}

/** Subscribe to a run: call.progress({stage, step, steps, fraction, left_s}), call.state({state, sentence}); returns a function to stop. */
export function events(id, call) {
  const source = new EventSource(address(`/runs/${id}/events`));
  const hear = (name) => source.addEventListener(name, (event) => call[name]?.(JSON.parse(event.data)));
  hear("progress");
  source.addEventListener("state", (event) => {
    const data = JSON.parse(event.data);
    call.state?.(data);
    if (["done", "failed", "cancelled"].includes(data.state)) source.close();
  });
  source.addEventListener("error", () => call.lost?.());
  return () => source.close();
}

/** POST the bytes of a file; calls `progress(sent, total)`. */
export function upload(path, query, file, progress = () => {}) {
  return new Promise((done, failed) => {
    const request = new XMLHttpRequest();
    request.open("POST", address(path, query));
    request.setRequestHeader("Content-Type", "application/octet-stream");
    request.responseType = "json";
    request.upload.addEventListener("progress", (event) => progress(event.loaded, event.total));
    request.addEventListener("error", () => failed(new ApiError("The upload failed: try again.", 0)));
    request.addEventListener("load", () => {
      if (request.status < 300) return done(request.response);
      const detail = request.response?.detail;
      failed(new ApiError(typeof detail === "string" ? detail : `The server answered ${request.status}.`, request.status));
    });
    request.send(file);
  });
}
