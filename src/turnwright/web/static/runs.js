/* The runs: start, follow, cancel, delete, and show their results. */

import { html, useState } from "./vendor/preact.js";
import { address, events, get, post, remove } from "./api.js";
import { lastText, settled, takeJob } from "./form.js";
import { GOING, follow as followMeasurement } from "./measurement.js";
import { say, set, state } from "./state.js";
import { Bar, Mark, Tool, clock, duration, useStore } from "./ui.js";

const POLL_MS = 5000; // interval of list updates while a run is active

/** State of a run before its results are loaded. */
const NOTHING = { result: null, made: null, files: [], maps: [], map: null, window: null, line: null, block: null };

const streams = new Map(); // id -> function that closes the event stream
const MAX_STREAMS = 2; // browsers allow six connections per server; further runs are followed by the list

function change(id, values) {
  set({ runs: state.runs.map((run) => (run.id === id ? { ...run, ...values } : run)) });
}

function follow(run) {
  if (streams.has(run.id) || streams.size >= MAX_STREAMS || run.state !== "running" || document.visibilityState === "hidden") return;
  const stop = events(run.id, {
    progress: (progress) => change(run.id, { progress }),
    state: (event) => {
      change(run.id, event);
      if (GOING.has(event.state)) return;
      streams.delete(run.id);
      refresh();
      ended(run.id, event);
    },
  });
  streams.set(run.id, stop);
}

function ended(id, { state: how, sentence }) {
  const run = state.runs.find((one) => one.id === id);
  if (how === "failed") say(`${run?.name ?? "The run"}: ${sentence}`, "bad");
  if (how === "done") {
    say(`${run?.name ?? "The run"} is done.`);
    if (id === state.run) look(id);
  }
}

let timer = 0;

/** Reload the list, and repeat while a run is active. */
export async function refresh() {
  clearTimeout(timer);
  try {
    const runs = await get("/runs");
    const before = new Map(state.runs.map((run) => [run.id, run]));
    set({ runs: runs.map((run) => ({ ...run, progress: run.progress ?? before.get(run.id)?.progress })) });
    for (const id of [state.run, state.comparison?.run, state.measurement?.id]) {
      // A run that was started during the request is not in the list yet.
      if (id && before.has(id) && !runs.some((run) => run.id === id)) forget(id);
    }
    for (const [id, stop] of streams) {
      if (runs.some((run) => run.id === id)) continue;
      stop();
      streams.delete(id);
    }
    for (const run of runs) {
      follow(run);
      const was = before.get(run.id);
      // A run that ended between two updates had no stream.
      if (was && GOING.has(was.state) && !GOING.has(run.state) && !streams.has(run.id)) ended(run.id, run);
    }
  } catch (error) {
    say(error.message, "bad");
  }
  if (state.runs.some((run) => GOING.has(run.state))) timer = setTimeout(refresh, state.runs.some((run) => run.state === "queued") ? 1000 : POLL_MS);
}

let hearing = null;

/** Subscribe to changes of the list while the page is visible. */
function hear() {
  hearing?.close();
  hearing = null;
  if (document.visibilityState === "hidden") {
    for (const stop of streams.values()) stop();
    streams.clear();
    return;
  }
  hearing = new EventSource(address("/runs/events"));
  hearing.addEventListener("runs", refresh);
}

let starting = false;

/** Start a run or a comparison of the current job; a double click starts only one. */
export async function start(kind = "run") {
  if (starting) return;
  starting = true;
  try {
    await settled();
    if (!state.job) return;
    if (state.errors.length) return say(`The job has an error: ${state.errors[0].sentence}`, "bad");
    const { id } = await post("/runs", { data: state.job, toml: lastText(), kind, name: state.job.part?.name || state.title || "job" });
    set({ run: id, ...NOTHING, ...(kind === "compare" ? { comparison: null } : {}) });
    await refresh();
  } catch (error) {
    say(error.message, "bad");
  } finally {
    starting = false;
  }
}

/** Load and show the results of a run. */
export async function look(id) {
  const run = state.runs.find((one) => one.id === id);
  if (id !== state.run) set({ run: id, ...NOTHING });
  if (!run || run.state !== "done") return undefined;
  try {
    if (run.kind === "measure") {
      await followMeasurement(id);
      if (id === state.run) set({ drawer: "measure", view: "drawer" });
      return undefined;
    }
    const { files, data } = await get(`/runs/${id}`);
    if (run.kind === "compare") {
      const comparison = await get(`/runs/${id}/comparison`);
      if (id === state.run) set({ comparison: { ...comparison, run: id, files, data }, files, drawer: "compare", view: "drawer" });
      return undefined;
    }
    const [result, maps] = await Promise.all([get(`/runs/${id}/result`), get(`/runs/${id}/maps`)]);
    if (id !== state.run) return undefined;
    const known = maps.some(({ name }) => name === state.map);
    set({ result, made: data, files, maps, map: known ? state.map : maps[0]?.name ?? null, drawer: ["profile", "motion", "program", "measure"].includes(state.drawer) ? state.drawer : "maps" });
  } catch (error) {
    say(error.message, "bad");
  }
  return undefined;
}

/** Load the job of a run into the form. */
export async function editAgain(id) {
  try {
    const { data, toml, name } = await get(`/runs/${id}`);
    takeJob({ job: data, written: toml, title: name, fresh: false });
  } catch (error) {
    say(error.message, "bad");
  }
}

/** Clear the results of a deleted run. */
function forget(id) {
  if (state.run === id) set({ run: null, ...NOTHING });
  if (state.comparison?.run === id) set({ comparison: null });
  if (state.measurement?.id === id) set({ measurement: null });
}

const dropping = new Set(); // ids being deleted, against double clicks

async function drop(run) {
  if (dropping.has(run.id)) return;
  dropping.add(run.id);
  try {
    if (GOING.has(run.state)) {
      await post(`/runs/${run.id}/cancel`);
    } else {
      await remove(`/runs/${run.id}`);
      forget(run.id);
    }
    await refresh();
  } catch (error) {
    say(error.message, "bad");
  } finally {
    dropping.delete(run.id);
  }
}

const STATE_TEXTS = { queued: "waiting", running: "running", done: "done", failed: "failed", cancelled: "cancelled" };

function Run({ run, chosen }) {
  const [sure, ask] = useState(false);
  const going = GOING.has(run.state);
  const { progress } = run;
  const share = progress?.fraction ?? 0;
  return html`<li class=${chosen ? "run chosen" : "run"} data-state=${run.state}>
    <button type="button" class="line" aria-pressed=${chosen ? "true" : "false"} onClick=${() => look(run.id)}>
      <${Mark} ok=${run.state === "done" ? !run.missed : run.state === "failed" ? false : null} warn=${run.missed} />
      <span class="what"><strong>${run.name}</strong><small>${run.kind === "run" ? "" : `${run.kind}, `}${STATE_TEXTS[run.state] ?? run.state}${run.missed ? ", misses a tolerance" : ""}${run.created ? `, ${clock(run.created)}` : ""}</small></span>
    </button>
    ${sure
      ? html`<span class="sure"><button type="button" class="button bad" onClick=${() => drop(run)}>Delete</button><button type="button" class="button" onClick=${() => ask(false)}>Keep</button></span>`
      : html`<${Tool} icon=${going ? "stop" : "bin"} name=${going ? `Cancel ${run.name}` : `Delete ${run.name}`} onClick=${() => (going ? drop(run) : ask(true))} />`}
    ${going && html`<div class="progress"><${Bar} share=${share} kind="going" />
      <span role="status">${run.state === "queued" ? "waiting for earlier runs" : progress ? `step ${progress.step} of ${progress.steps}, ${progress.stage}: ${Math.floor(share * 100)} %` : "starting"}</span>
      <span class="gap"></span>${progress?.steps > 0 && html`<span class="number">${duration(progress.left_s)} left</span>`}</div>`}
    ${run.state === "failed" && run.sentence && html`<p class="wrong">${run.sentence}</p>`}
  </li>`;
}

/** The list of runs. */
export function Queue() {
  const { runs, run } = useStore(["runs", "run"]);
  if (!runs.length) {
    return html`<p class="quiet pad">No runs yet. <strong>Run</strong> plans the job, writes the NC program and simulates the surface from it; <strong>Compare</strong> plans the finishing pass with every strategy of the machine.</p>`;
  }
  return html`<ul class="runs">${runs.map((one) => html`<${Run} key=${one.id} run=${one} chosen=${one.id === run} />`)}</ul>`;
}

/** Follow the runs; the results pane draws the list. */
export function mount() {
  // The first event arrives at once; a hidden page loads the list, too.
  if (document.visibilityState === "hidden") refresh();
  hear();
  document.addEventListener("visibilitychange", hear);
  return {
    destroy: () => {
      document.removeEventListener("visibilitychange", hear);
      hearing?.close();
      clearTimeout(timer);
      for (const stop of streams.values()) stop();
      streams.clear();
    },
  };
}
