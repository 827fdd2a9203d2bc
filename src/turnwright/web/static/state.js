/* The one store of the page. A module reads `state.key`, writes with `set`, and listens with `on`.

   import { state, set, on } from "./state.js";
   on(["run", "map"], ({ run, map }) => draw(), { now: true });   // one call a frame, however many keys changed
   set({ place: 0.3 });

   Every module exports mount(element, options?) -> { destroy() }, and renders from the store alone.
   Lengths are mm, angles rad, times s, as in the HTTP contract; x, y are of the part frame.

   key           what                                                                     set by
   --            the page
   about         GET /api/about                                                           app.js
   theme         "light" | "dark": the scheme in force (also <html data-theme>)           app.js
   drawer        the lower tab: "maps" | "profile" | "motion" | "compare" | "program" | "measure"; null closed   app.js, anyone
   view          the pane that a phone shows: "left" | "middle" | "right" | "drawer"     app.js, anyone
   notice        {sentence, kind: "info" | "bad"} | null: the line at the foot            anyone, by say()
   --            the job
   schema        GET /api/schema                                                          app.js
   examples      [{name, title, summary}]                                                 app.js
   title         what the job is called: the name of the example or the file             app.js
   job           data of the job as the form shows it | null while the page is empty      form.js, app.js
   toml          the same as text                                                         form.js, app.js
   errors        [{field, sentence}]                                                      form.js
   check         answer of POST /api/job/check, the last with an access; it is of the job as typed where check.errors === errors   form.js
   checking      true while an answer is on its way                                       form.js
   --            the scene
   quantity      what colours the part: "height" | "slope" | "curvature" | "clearance margin" | "chip thickness" of the job,
                "error" | "chips" of the run                                             scene.js
   place         where the tool stands on the finishing spiral, 0 at the first point .. 1 at the last   scene.js, program.js
   cursor        [x, y] on the part that is pointed at, in any view | null                scene.js, mapview.js, program.js
   --            the runs
   runs          [{id, name, kind, state, created, started, ended, sentence, progress?}]; progress {stage, step, steps, fraction, left_s}   runs.js
   run           id of the run looked at | null                                           runs.js
   result        result.json of that run | null                                           runs.js
  made          data of the job that it carried out | null                               runs.js
   files         what that run has left: [{name, part, file, bytes}]                      runs.js
   comparison    comparison.json of the last comparison looked at, with its run, files and the data of its job | null   runs.js
   maps          GET /api/runs/{id}/maps of that run: [{name, unit, ...}]                 runs.js
   map           name of the map looked at | null                                         runs.js (the first), mapview.js
   window        {x0, x1, y0, y1} of the map in view | null: all of it                    mapview.js
   line          {x0, y0, x1, y1} of the profile that was drawn | null                    mapview.js
   block         number of the program line pointed at, from 0 | null                     program.js, scene.js
   --            the measurement
   measurement   GET /api/measurements/{id} with its id | null                            measurement.js
*/

export const state = {
  about: null,
  theme: "light",
  drawer: null,
  view: "middle",
  notice: null,
  schema: null,
  examples: [],
  title: "",
  job: null,
  toml: "",
  errors: [],
  check: null,
  checking: false,
  quantity: "height",
  place: 0,
  cursor: null,
  runs: [],
  run: null,
  result: null,
  made: null,
  files: [],
  comparison: null,
  maps: [],
  map: null,
  window: null,
  line: null,
  block: null,
  measurement: null,
};

const listeners = new Set();
let changed = new Set();
let due = false;

function notify() {
  due = false;
  const keys = changed;
  changed = new Set();
  for (const listener of [...listeners]) {
    if (!listener.keys.some((key) => keys.has(key))) continue;
    // An error in one view must not affect the others.
    try {
      listener.call(state, keys);
    } catch (error) {
      console.error(error);
    }
  }
}

/** Change keys of the store; listeners are called once before the next frame. */
export function set(values) {
  for (const [key, value] of Object.entries(values)) {
    if (!(key in state)) throw new Error(`the store has no key ${key}`);
    if (Object.is(state[key], value)) continue;
    state[key] = value;
    changed.add(key);
  }
  if (changed.size && !due) {
    due = true;
    queueMicrotask(notify);
  }
}

/** Call `call(state, changedKeys)` when one of `keys` has changed; returns a function to stop. */
export function on(keys, call, { now = false } = {}) {
  const listener = { keys: [].concat(keys), call };
  listeners.add(listener);
  if (now) call(state, new Set(listener.keys));
  return () => listeners.delete(listener);
}

/** Show one sentence at the foot of the page. */
export function say(sentence, kind = "info") {
  set({ notice: sentence ? { sentence, kind } : null });
}
