/* The page: bars, panes, keys, files and themes. */

import { Fragment, html, render, useEffect, useRef, useState } from "./vendor/preact.js";
import { get, postForFile, reach, upload } from "./api.js";
import { checkSoon, currentToml, lastText, mount as mountForm, namesFiles, openings, readToml, redo, settled, takeJob, undo } from "./form.js";
import { mount as mountVerdict } from "./verdict.js";
import { mount as mountRuns, refresh, start } from "./runs.js";
import { askAhead } from "./seen.js";
import { on, say, set, state } from "./state.js";
import { Icon, Mark, Tool, fileName, saveText, useStore } from "./ui.js";

const $ = (id) => document.getElementById(id);

// ------------------------------------------------------------------------------------------------------ what is kept

/** Layout settings in local storage, if available. */
const kept = {
  read(key, otherwise) {
    try {
      return localStorage.getItem(`turnwright.${key}`) ?? otherwise;
    } catch {
      return otherwise;
    }
  },
  write(key, value) {
    try {
      if (value === null) localStorage.removeItem(`turnwright.${key}`);
      else localStorage.setItem(`turnwright.${key}`, value);
    } catch {
      // Local storage is not available.
    }
  },
};

/** The job is kept across reloads in the same tab. */
const tab = {
  read() {
    try {
      return JSON.parse(sessionStorage.getItem("turnwright.job"));
    } catch {
      return null;
    }
  },
  write(value) {
    try {
      sessionStorage.setItem("turnwright.job", JSON.stringify(value));
    } catch {
      // Too large, or session storage is not available.
    }
  },
};

// ---------------------------------------------------------------------------------------------------- light and dark

const dark = matchMedia("(prefers-color-scheme: dark)");
const ONE_PANE = matchMedia("(max-width: 640px)"); // as in style.css

function applyTheme() {
  const theme = kept.read("theme", dark.matches ? "dark" : "light");
  document.documentElement.dataset.theme = theme;
  set({ theme });
}

function switchTheme() {
  const next = state.theme === "dark" ? "light" : "dark";
  kept.write("theme", next === (dark.matches ? "dark" : "light") ? null : next);
  applyTheme();
}

// ------------------------------------------------------------------------------------------------------ files in, out

let wanted = "";

async function takeExample(name) {
  wanted = name;
  const before = openings();
  try {
    const example = await get(`/examples/${encodeURIComponent(name)}`);
    // Another one was chosen in the meantime.
    if (wanted !== name || before !== openings()) return;
    const known = state.examples.find((one) => one.name === name);
    takeJob({ job: example.data, toml: example.toml, errors: example.errors ?? [], title: known?.title ?? name });
    say("");
  } catch (error) {
    say(error.message, "bad");
  }
}

const EMPTY = {
  part: { name: "new part", surface: { family: "sphere", radius: "60 mm" }, radius: "5 mm" },
  tool: { nose_radius: "0.5 mm", included: "60 deg", clearance: "10 deg" },
  machine: { name: "generic" },
  strategy: { kind: "slow tool servo", feed: "8 um/rev", points_per_rev: 360 },
};

const takeEmpty = () => takeJob({ job: structuredClone(EMPTY), title: "new job" });

async function takeFile(file) {
  if (/\.zip$/i.test(file.name)) return takeArchive(file);
  try {
    const why = await readToml(await file.text(), { title: file.name.replace(/\.toml$/i, ""), fresh: true });
    if (why) say(`${file.name}: ${why}`, "bad");
    else say("");
  } catch (error) {
    say(error.message, "bad");
  }
}

/** Open an archive of a job and its files. */
async function takeArchive(file) {
  const most = state.about?.limits.file_bytes ?? Infinity;
  if (file.size > most) return say(`${file.name} has ${Math.ceil(file.size / 2 ** 20)} MiB, the limit is ${most / 2 ** 20} MiB: upload the files one by one.`, "bad");
  const mine = (wanted = file);
  const before = openings();
  try {
    const { data, toml, errors } = await upload("/files/archive", {}, file);
    // Another one was chosen in the meantime.
    if (wanted !== mine || before !== openings()) return;
    takeJob({ job: data, toml, title: file.name.replace(/\.zip$/i, ""), errors });
    say("");
  } catch (error) {
    say(`${file.name}: ${error.message}`, "bad");
  }
}

function openFile() {
  const input = document.createElement("input");
  input.type = "file";
  input.accept = ".toml,.zip,text/plain";
  input.addEventListener("change", () => input.files[0] && takeFile(input.files[0]));
  input.click();
}

async function saveFile() {
  if (!state.job) return;
  const name = fileName(state.job.part?.name || state.title);
  try {
    await settled();
    if (namesFiles()) saveText(await postForFile("/job/bundle", { data: state.job, toml: lastText() }), `${name}.zip`);
    else saveText(await currentToml(), `${name}.toml`);
  } catch (error) {
    say(error.message, "bad");
  }
}

/** Dropped job files are opened; other files are uploaded as measurements. */
function takeDrops() {
  const over = (event) => {
    if (![...event.dataTransfer.types].includes("Files")) return;
    event.preventDefault();
    document.body.classList.add("dropping");
  };
  addEventListener("dragenter", over);
  addEventListener("dragover", over);
  addEventListener("dragleave", (event) => event.relatedTarget === null && document.body.classList.remove("dropping"));
  addEventListener("drop", async (event) => {
    event.preventDefault();
    document.body.classList.remove("dropping");
    const file = event.dataTransfer.files[0];
    if (!file) return;
    if (/\.(toml|zip)$/i.test(file.name)) return takeFile(file);
    set({ drawer: "measure", view: "drawer" });
    const { take } = await import("./measure.js");
    take(file);
  });
}

// -------------------------------------------------------------------------------------------------------- the top bar

function Top({ panes }) {
  const { job, errors, check, checking, examples, title, theme, runs } = useStore(["job", "errors", "check", "checking", "examples", "title", "theme", "runs"]);
  const going = runs.filter((run) => run.state === "running" || run.state === "queued").length;
  const refused = check?.preview?.refused?.length > 0;
  const word = !job ? null
    : errors.length && check?.errors === errors && !check.access.ok ? { ok: false, text: "no access to the part" }
    : errors.length ? { ok: false, text: errors.length === 1 ? "1 field to correct" : `${errors.length} fields to correct` }
    : !check ? { ok: null, text: checking ? "checking …" : "not checked" }
    : check.access.ok && !refused ? { ok: true, text: "access to the part" }
    : { ok: false, text: check.access.ok ? "a run would stop" : "no access to the part" };
  return html`<${Fragment}>
    <span class="brand"><svg viewBox="0 0 24 24" aria-hidden="true"><path d="M2 15q5 6 10 0t10 0" /><path d="m8.5 2.500h7l-2.300 9a1.2 1.250 0 0 1-2.400 0z" /></svg>Turnwright</span>
    <${Tool} icon="left" name="Job pane" keys="[" aria-controls="left" onClick=${() => panes.flip("left")} />
    <label class="picker"><span class="sr">Example</span><select id="examples" onChange=${(event) => { if (event.target.value) takeExample(event.target.value); event.target.value = ""; }}>
      <option value="" selected>Examples</option>${examples.map((one) => html`<option value=${one.name}>${one.title}</option>`)}</select></label>
    <${Tool} icon="open" name="Open a job file" keys="Ctrl+O" onClick=${openFile} />
    <${Tool} icon="save" name="Save the job file" keys="Ctrl+S" disabled=${!job} onClick=${saveFile} />
    <h1 title=${job?.part?.name || title}>${job?.part?.name || title || "No job yet"}</h1>
    ${word && html`<span class=${`pill ${word.ok === null ? "" : word.ok ? "good" : "bad"}${checking ? " waiting" : ""}`} id="pill"><${Mark} ok=${word.ok} />${word.text}</span>`}
    <span class="gap"></span>
    <button type="button" class="button" disabled=${!job || errors.length > 0} onClick=${() => start("compare")} title="Plan the finishing pass with every strategy of the machine"><${Icon} name="compare" />Compare</button>
    <button type="button" class="button accent" id="run" disabled=${!job || errors.length > 0} onClick=${() => start("run")} title="Plan, write the program, simulate the surface  (Ctrl+Enter)"><${Icon} name="run" />Run${going > 0 && html` <span class="count">${going}</span>`}</button>
    <${Tool} icon=${theme === "dark" ? "sun" : "moon"} name=${theme === "dark" ? "Light" : "Dark"} keys="T" onClick=${switchTheme} />
    <${Tool} icon="help" name="Help and keys" keys="?" onClick=${() => $("help").showModal()} />
    <${Tool} icon="right" name="Results pane" keys="]" aria-controls="right" onClick=${() => panes.flip("right")} />
  </${Fragment}>`;
}

// -------------------------------------------------------------------------------------------------------- the drawer

const TABS = [
  { name: "maps", title: "Maps", module: "./mapview.js" },
  { name: "profile", title: "Profile", module: "./charts.js", mount: "mountProfile" },
  { name: "motion", title: "Motion & spectrum", module: "./charts.js", mount: "mountMotion" },
  { name: "compare", title: "Compare", module: "./compare.js" },
  { name: "program", title: "Program", module: "./program.js" },
  { name: "measure", title: "Measure", module: "./measure.js" },
];

const mounted = new Set();

async function openTab(name) {
  for (const tab of TABS) $(`panel-${tab.name}`).hidden = tab.name !== name;
  const tab = TABS.find((one) => one.name === name);
  if (!tab || mounted.has(name)) return;
  mounted.add(name);
  const module = await import(tab.module);
  module[tab.mount ?? "mount"]($(`panel-${name}`));
}

function Tabs({ panes }) {
  const { drawer } = useStore(["drawer"]);
  const row = useRef(null);
  const keys = (event) => {
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!by) return;
    const at = TABS.findIndex(({ name }) => name === drawer);
    const next = TABS[(at + by + TABS.length) % TABS.length].name;
    set({ drawer: next });
    row.current.querySelector(`#tab-${next}`).focus();
  };
  useEffect(() => row.current.querySelector("[aria-selected=true]")?.scrollIntoView({ block: "nearest", inline: "nearest" }), [drawer]);
  return html`<div class="panehead"><div class="tabs" role="tablist" aria-label="Lower area" ref=${row} onKeyDown=${keys}>
    ${TABS.map(({ name, title }, index) => html`<button type="button" role="tab" id=${`tab-${name}`} aria-controls=${`panel-${name}`} aria-selected=${drawer === name ? "true" : "false"}
      tabindex=${drawer === name || (!drawer && index === 0) ? 0 : -1} title=${`${title}  (${index + 1})`} onClick=${() => set({ drawer: drawer === name && !ONE_PANE.matches ? null : name })}>${title}</button>`)}</div>
    <span class="gap"></span>
    <${Tool} icon="tall" name="Larger or smaller" keys="0" onClick=${() => panes.tall()} />
    <${Tool} icon=${drawer ? "down" : "up"} name=${drawer ? "Close the lower area" : "Open the lower area"} keys="Esc" onClick=${() => set({ drawer: drawer ? null : "maps" })} /></div>`;
}

// --------------------------------------------------------------------------------------------------------- the panes

const SIZES = { left: [240, 560, 304], right: [240, 560, 296], drawer: [140, 900, 300] };
const NARROW = matchMedia("(max-width: 1100px)");

function makePanes() {
  const bench = $("bench");
  const sizes = Object.fromEntries(Object.entries(SIZES).map(([name, [, , first]]) => [name, Number(kept.read(name, first)) || first]));
  const splitters = Object.fromEntries([...bench.querySelectorAll("[data-splits]")].map((one) => [one.dataset.splits, one]));

  const resize = (name, wanted) => {
    const [least, most] = SIZES[name];
    const room = name === "drawer" ? bench.clientHeight - 120 : bench.clientWidth - 360;
    const size = Math.round(Math.max(least, Math.min(most, room, wanted)));
    sizes[name] = size;
    bench.style.setProperty(`--${name}`, `${size}px`);
    const splitter = splitters[name];
    for (const [key, value] of [["valuenow", size], ["valuemin", least], ["valuemax", most]]) splitter.setAttribute(`aria-${key}`, value);
  };

  const show = (name, open) => {
    bench.dataset[name] = open ? "open" : "closed";
    // On a tablet only one side pane fits next to the scene.
    if (open && NARROW.matches) bench.dataset[name === "left" ? "right" : "left"] = "closed";
  };

  for (const [name, splitter] of Object.entries(splitters)) {
    const along = name === "drawer" ? "clientY" : "clientX";
    const sense = name === "left" ? 1 : -1;
    splitter.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      splitter.setPointerCapture(event.pointerId);
      const [from, size] = [event[along], sizes[name]];
      const move = (moved) => resize(name, size + sense * (moved[along] - from));
      splitter.addEventListener("pointermove", move);
      splitter.addEventListener("lostpointercapture", () => {
        splitter.removeEventListener("pointermove", move);
        kept.write(name, String(sizes[name]));
      }, { once: true });
    });
    splitter.addEventListener("keydown", (event) => {
      const [less, more] = name === "drawer" ? ["ArrowDown", "ArrowUp"] : name === "left" ? ["ArrowLeft", "ArrowRight"] : ["ArrowRight", "ArrowLeft"];
      const by = { [less]: -20, [more]: 20 }[event.key];
      if (!by) return;
      event.preventDefault();
      resize(name, sizes[name] + by);
      kept.write(name, String(sizes[name]));
    });
    splitter.addEventListener("dblclick", () => resize(name, SIZES[name][2]));
    resize(name, sizes[name]);
  }

  const narrow = () => {
    bench.dataset.right = NARROW.matches ? "closed" : "open";
    bench.dataset.left = "open";
  };
  NARROW.addEventListener("change", narrow);
  narrow();
  addEventListener("resize", () => Object.entries(sizes).forEach(([name, size]) => resize(name, size)));
  return {
    flip: (name) => show(name, bench.dataset[name] === "closed"),
    show,
    tall: () => {
      const high = Math.round(bench.clientHeight * 0.68);
      resize("drawer", sizes.drawer > high - 40 ? SIZES.drawer[2] : high);
      if (!state.drawer) set({ drawer: "maps" });
    },
  };
}

/** On a phone one pane is shown at a time, chosen by a row of buttons. */
const VIEWS = { left: "Job", middle: "Scene", right: "Results", drawer: "Maps" };

function Views() {
  const { view } = useStore(["view"]);
  const choose = (name) => set({ view: name, ...(name === "drawer" && !state.drawer ? { drawer: "maps" } : {}) });
  return html`${Object.entries(VIEWS).map(([name, title]) => html`<button type="button" aria-pressed=${view === name ? "true" : "false"} onClick=${() => choose(name)}>${title}</button>`)}`;
}

// ------------------------------------------------------------------------------------------------------- empty state

const STEPS = [
  ["Describe", "Surface, tool, machine and strategy, as form fields with units or as TOML. Every field is explained."],
  ["See", "The part, the spiral path and the tool in contact, with an immediate check of tool access."],
  ["Run", "The NC program is written, and the surface it produces is simulated to the nanometre."],
  ["Correct", "Drop a measured map. Errors of tool, machine and mount are identified with their uncertainty, and the next program corrects them."],
];

function Welcome() {
  const { examples } = useStore(["examples"]);
  return html`<div class="welcome">
    <h2>From a prescription to a proven program</h2>
    <p class="lead">Plan a diamond-turned part, simulate its surface, and correct the job by a measurement.</p>
    <ol class="steps">${STEPS.map(([title, text]) => html`<li><h3>${title}</h3><p>${text}</p></li>`)}</ol>
    <h3>Start with an example</h3>
    <ul class="examples">${examples.map((one) => html`<li><button type="button" onClick=${() => takeExample(one.name)}><strong>${one.title}</strong><span>${one.summary}</span></button></li>`)}</ul>
    <p class="or"><button type="button" class="button" onClick=${openFile}><${Icon} name="open" />Open a job file</button>
      <button type="button" class="button" onClick=${takeEmpty}><${Icon} name="plus" />Start with a small sphere</button>
      <span class="quiet">or drop a job file anywhere on the page</span></p>
  </div>`;
}

// -------------------------------------------------------------------------------------------------------------- keys

const KEYS = [
  ["Ctrl+Enter", "run the job"],
  ["Ctrl+O, Ctrl+S", "open, save the job file"],
  ["Ctrl+Z, Ctrl+Shift+Z", "undo, redo (in a field: its text)"],
  ["1 … 6", "maps, profile, motion, compare, program, measure"],
  ["0, Esc", "resize, close the lower area"],
  ["[, ]", "job pane, results pane"],
  ["T", "light or dark"],
  ["Tab, Shift+Tab", "move through fields and buttons; the focused field is explained"],
  ["↑ ↓", "in a field: step the last digit, with Shift ten steps"],
  ["← →  ↑ ↓", "on a splitter: move it; on a map or the scene: move the view"],
  ["+, −", "on a map or the scene: zoom in, out"],
];

function Help() {
  return html`<${Fragment}>
    <header><h2 id="help-title">Help</h2><span class="gap"></span><${Tool} icon="close" name="Close" onClick=${() => $("help").close()} /></header>
    <div class="columns"><section><h3>Where things are</h3>
      <p><strong>Left, the job.</strong> Part, tool, machine and strategy. A number without a unit has the unit shown in the field; any other unit can be written with it.</p>
      <p><strong>Middle, the scene.</strong> The nominal surface with z toward the tool, coloured by the chosen map; the spiral of the finishing pass; the tool at the position of the slider.</p>
      <p><strong>Right, the results.</strong> The check of the current job under Plan, results under Runs. The mark on a bar is its limit.</p>
      <p><strong>Below, the details.</strong> Maps down to single cusps (error is cut minus nominal surface, positive where material remains), profiles along a line, axis motion and limits, strategies, the program, measurements.</p></section>
    <section><h3>Keys</h3><table class="small keys"><tbody>${KEYS.map(([keys, text]) => html`<tr><th scope="row">${keys.split(", ").map((one, index) => html`${index ? " " : ""}<kbd>${one}</kbd>`)}</th><td>${text}</td></tr>`)}</tbody></table></section></div>
  </${Fragment}>`;
}

function takeKeys(panes) {
  addEventListener("keydown", (event) => {
    const typing = event.target.closest?.("input:not([type=checkbox]):not([type=range]), textarea, select, [contenteditable]");
    if (event.ctrlKey || event.metaKey) {
      const act = { Enter: () => start("run"), s: saveFile, o: openFile }[event.key];
      if (act) {
        event.preventDefault();
        // Commit the text of the focused field.
        typing?.blur();
        typing?.focus();
        return act();
      }
      if (!typing && event.key.toLowerCase() === "z") {
        event.preventDefault();
        return event.shiftKey ? redo() : undo();
      }
      return undefined;
    }
    if (typing || event.altKey || document.querySelector("dialog[open]")) return undefined;
    if (/^[1-6]$/.test(event.key)) return set({ drawer: TABS[Number(event.key) - 1].name, view: "drawer" });
    const act = { 0: panes.tall, "[": () => panes.flip("left"), "]": () => panes.flip("right"), t: switchTheme, "?": () => $("help").showModal(), Escape: () => set({ drawer: null }) }[event.key];
    return act?.();
  });
}

// -------------------------------------------------------------------------------------------------------------- foot

function Foot() {
  const { notice, about, checking } = useStore(["notice", "about", "checking"]);
  const [now, tick] = useState(0);
  useEffect(() => {
    // Messages of success disappear.
    if (notice?.kind !== "info") return undefined;
    const timer = setTimeout(() => say(""), 6000);
    return () => clearTimeout(timer);
  }, [notice]);
  useEffect(() => on("job", () => tick((times) => times + 1)), []);
  return html`<span class=${notice ? `notice ${notice.kind}` : "quiet"}>${notice ? notice.sentence : now || checking ? "Lengths in mm; error = cut minus nominal surface along z; z points toward the tool." : "Ready."}</span>
    ${notice?.kind === "bad" && html`<${Tool} icon="close" name="Dismiss" onClick=${() => say("")} />`}
    <span class="gap"></span><span class="quiet">${about ? `Turnwright ${about.version}` : ""}</span>`;
}

// ---------------------------------------------------------------------------------------------- the server, if it goes

const RETRY_MS = 2000; // interval of attempts to reach the server
let gone = 0;

/** Try to reach the server again, then reload the data of the page. */
function lost() {
  if (gone) return;
  gone = setInterval(async () => {
    const answer = await fetch("/api/about", { cache: "no-store" }).catch(() => null);
    if (!answer?.ok) return;
    clearInterval(gone);
    gone = 0;
    say("The server is available again.");
    await ask();
    if (state.job) checkSoon(0);
    refresh();
  }, RETRY_MS);
}

/** Load the data that the page needs and does not have yet. */
async function ask() {
  const once = async (path, key) => {
    if (state[key]?.length ?? state[key]) return;
    try {
      set({ [key]: await get(path) });
    } catch (error) {
      say(error.message, "bad");
    }
  };
  await Promise.all([once("/about", "about"), once("/schema", "schema"), once("/examples", "examples")]);
}

// ------------------------------------------------------------------------------------------------------------- start

let scene = null;

/** Load the scene, which is large, after the page or with the first job. */
function makeScene() {
  scene ??= import("./scene.js").then(({ mount }) => mount($("scene")));
  return scene;
}

async function showScene() {
  const welcomed = state.job && !$("welcome").hidden;
  // Move the focus to the job when the welcome page with the focused button is hidden.
  const follow = welcomed && $("welcome").contains(document.activeElement);
  $("welcome").hidden = Boolean(state.job);
  if (welcomed) set({ view: "left" });
  if (follow) setTimeout(() => $("left").focus());
  $("scene").hidden = !state.job;
  if (!state.job || $("scene").hasChildNodes()) return;
  if (!state.errors.length) askAhead(state.job, state.quantity);
  await makeScene();
}

async function begin() {
  applyTheme();
  dark.addEventListener("change", applyTheme);
  const panes = makePanes();
  render(html`<${Top} panes=${panes} />`, $("top"));
  render(html`<${Tabs} panes=${panes} />`, $("tabs"));
  render(html`<${Views} />`, $("views"));
  render(html`<${Welcome} />`, $("welcome"));
  render(html`<${Help} />`, $("help"));
  render(html`<${Foot} />`, $("foot"));
  mountForm($("form"));
  mountVerdict($("right"));
  mountRuns();
  takeKeys(panes);
  takeDrops();
  on("view", ({ view }) => ($("bench").dataset.view = view), { now: true });
  on("drawer", ({ drawer }) => {
    $("bench").dataset.drawer = drawer ? "open" : "closed";
    if (!drawer && state.view === "drawer") set({ view: "middle" });
    openTab(drawer).catch((error) => say(`This part of the page did not load (${error.message}): reload the page.`, "bad"));
  }, { now: true });
  on("job", () => showScene().catch((error) => say(`The scene did not load (${error.message}): reload the page.`, "bad")), { now: true });
  on("run", ({ run }) => {
    if (!run) return;
    panes.show("right", true);
    set({ view: "right" });
  });
  reach.lost = lost;
  // Load the scene after the examples are painted.
  const stop = on("examples", () => {
    stop();
    requestAnimationFrame(() => setTimeout(() => makeScene().catch(() => {}))); // the error is shown once there is a job
  });
  await ask();
  const last = tab.read();
  if (last?.job && !state.job) takeJob({ job: last.job, written: last.written, title: last.title, errors: last.errors ?? [] });
  on(["job", "title", "errors", "toml"], ({ job, title, errors }) => tab.write({ job, title, errors, written: lastText() }));
  addEventListener("focus", refresh);
}

begin();
