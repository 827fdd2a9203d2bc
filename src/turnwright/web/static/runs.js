/* The runs: started, followed while they last, looked at when they are done. */

import { html, useState } from "./vendor/preact.js";
import { address, events, get, post, remove } from "./api.js";
import { lastText, settled, takeJob } from "./form.js";
import { say, set, state } from "./state.js";
import { Bar, Mark, Tool, clock, duration, useStore } from "./ui.js";

const GOING = new Set(["queued", "running"]);
const EVERY = 5000; // ms between looks at the list while something goes on

/** What is known of a run before it is looked at. */
const NOTHING = { result: null, made: null, files: [], maps: [], map: null, window: null, line: null, block: null };

const heard = new Map(); // id -> how to stop hearing it
const MOST_HEARD = 2; // a browser keeps six lines to a server, for all its pages: the list tells of further runs

function change(id, values) {
  set({ runs: state.runs.map((run) => (run.id === id ? { ...run, ...values } : run)) });
}

function follow(run) {
  if (heard.has(run.id) || heard.size >= MOST_HEARD || run.state !== "running" || document.visibilityState === "hidden") return;
  const stop = events(run.id, {
    progress: (progress) => change(run.id, { progress }),
    state: (told) => {
      change(run.id, told);
      if (GOING.has(told.state)) return;
      heard.delete(run.id);
      refresh();
      ended(run.id, told);
    },
  });
  heard.set(run.id, stop);
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

/** Ask for the list anew, and again while something goes on. */
export async function refresh() {
  clearTimeout(timer);
  try {
    const runs = await get("/runs");
    const before = new Map(state.runs.map((run) => [run.id, run]));
    set({ runs: runs.map((run) => ({ ...run, progress: run.progress ?? before.get(run.id)?.progress })) });
    for (const id of [state.run, state.comparison?.run, state.measurement?.id]) {
      // One that was begun while the list was on its way is not in it yet.
      if (id && before.has(id) && !runs.some((run) => run.id === id)) forget(id);
    }
    for (const [id, stop] of heard) {
      if (runs.some((run) => run.id === id)) continue;
      stop();
      heard.delete(id);
    }
    for (const run of runs) {
      follow(run);
      const was = before.get(run.id);
      // One that ended between two looks was not heard.
      if (was && GOING.has(was.state) && !GOING.has(run.state) && !heard.has(run.id)) ended(run.id, run);
    }
  } catch (error) {
    say(error.message, "bad");
  }
  if (state.runs.some((run) => GOING.has(run.state))) timer = setTimeout(refresh, state.runs.some((run) => run.state === "queued") ? 1000 : EVERY);
}

let hearing = null;

/** Hear of every change of the list, whoever makes it, while the page is looked at; of runs as well. */
function hear() {
  hearing?.close();
  hearing = null;
  if (document.visibilityState === "hidden") {
    for (const stop of heard.values()) stop();
    heard.clear();
    return;
  }
  hearing = new EventSource(address("/runs/events"));
  hearing.addEventListener("runs", refresh);
}

let starting = false;

/** Start a run or a comparison of the job as it stands; a double click starts one. */
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

/** Fetch what a run found, and show it. */
export async function look(id) {
  const run = state.runs.find((one) => one.id === id);
  if (id !== state.run) set({ run: id, ...NOTHING });
  if (!run || run.state !== "done") return undefined;
  try {
    if (run.kind === "measure") {
      const { follow: show } = await import("./measure.js");
      set({ drawer: "measure", view: "drawer" });
      return await show(id);
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

/** Take the job that a run carried out into the fields. */
export async function editAgain(id) {
  try {
    const { data, toml, name } = await get(`/runs/${id}`);
    takeJob({ job: data, written: toml, title: name, fresh: false });
  } catch (error) {
    say(error.message, "bad");
  }
}

/** Show nothing more of a run that is no longer there. */
function forget(id) {
  if (state.run === id) set({ run: null, ...NOTHING });
  if (state.comparison?.run === id) set({ comparison: null });
  if (state.measurement?.id === id) set({ measurement: null });
}

const dropping = new Set(); // ids on their way out: a double click asks once

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

const SAID = { queued: "waits", running: "runs", done: "done", failed: "failed", cancelled: "cancelled" };

function Run({ run, chosen }) {
  const [sure, ask] = useState(false);
  const going = GOING.has(run.state);
  const { progress } = run;
  const share = progress?.fraction ?? 0;
  return html`<li class=${chosen ? "run chosen" : "run"} data-state=${run.state}>
    <button type="button" class="line" aria-pressed=${chosen ? "true" : "false"} onClick=${() => look(run.id)}>
      <${Mark} ok=${run.state === "done" ? !run.missed : run.state === "failed" ? false : null} warn=${run.missed} />
      <span class="what"><strong>${run.name}</strong><small>${run.kind === "run" ? "" : `${run.kind}, `}${SAID[run.state] ?? run.state}${run.missed ? ", misses a tolerance" : ""}${run.created ? `, ${clock(run.created)}` : ""}</small></span>
    </button>
    ${sure
      ? html`<span class="sure"><button type="button" class="button bad" onClick=${() => drop(run)}>Delete</button><button type="button" class="button" onClick=${() => ask(false)}>Keep</button></span>`
      : html`<${Tool} icon=${going ? "stop" : "bin"} name=${going ? `Cancel ${run.name}` : `Delete ${run.name}`} onClick=${() => (going ? drop(run) : ask(true))} />`}
    ${going && html`<div class="progress"><${Bar} share=${share} kind="going" />
      <span role="status">${run.state === "queued" ? "behind the runs before it" : progress ? `step ${progress.step} of ${progress.steps}, ${progress.stage}: ${Math.floor(share * 100)} %` : "begins"}</span>
      <span class="gap"></span>${progress?.steps > 0 && html`<span class="number">${duration(progress.left_s)} more</span>`}</div>`}
    ${run.state === "failed" && run.sentence && html`<p class="wrong">${run.sentence}</p>`}
  </li>`;
}

/** The list of runs. */
export function Queue() {
  const { runs, run } = useStore(["runs", "run"]);
  if (!runs.length) {
    return html`<p class="quiet pad">Nothing has run. <strong>Run</strong> plans the whole job, writes the program, reads it back and predicts the surface it leaves; <strong>Compare</strong> plans it by every strategy that the machine can do.</p>`;
  }
  return html`<ul class="runs">${runs.map((one) => html`<${Run} key=${one.id} run=${one} chosen=${one.id === run} />`)}</ul>`;
}

/** Follow the runs; the list itself is drawn by the results pane. */
export function mount() {
  // The first event comes at once; a page that nobody looks at has its list, too.
  if (document.visibilityState === "hidden") refresh();
  hear();
  document.addEventListener("visibilitychange", hear);
  return {
    destroy: () => {
      document.removeEventListener("visibilitychange", hear);
      hearing?.close();
      clearTimeout(timer);
      for (const stop of heard.values()) stop();
      heard.clear();
    },
  };
}
