/* The job pane: fields generated from the job schema, or the job as TOML; every change is checked at once. */

import { Fragment, html, render, useEffect, useRef, useState } from "./vendor/preact.js";
import { post, upload } from "./api.js";
import { say, set, state } from "./state.js";
import { Icon, Tool, useStore } from "./ui.js";

const CHECK_DELAY = 60; // ms after the last key before a job is checked
const REST = 300; // ms after which a change stands alone, and is checked at once
const PAUSE_TOML = 400; // ms without a key before text is read
const STEPS_BACK = 200;
const CLIENT = crypto.getRandomValues(new Uint32Array(2)).join("-");
const NONE_YET = { passes: "One finishing pass, as the strategy states." };
/** Initial values of a new list entry. */
const FIRST = {
  passes: { name: "finish" },
  "simulation.patches": { name: "middle", centre: ["0 mm", "0 mm"], size: ["100 um", "100 um"], pixel: "0.5 um" },
};
const OPEN_AT_FIRST = new Set(["part", "tool", "machine", "strategy"]);

// ---------------------------------------------------------------------------------------------- the job and its past

const past = [];
const future = [];
let lastEdit = { key: "", when: 0 };

/** The last text that was read or written, and its job; its comments are kept when the job changes. */
let base = { job: null, toml: "" };

/** The last text of the job, without later changes. */
export const lastText = () => base.toml;

let opened = 0; // jobs so far

/** Number of opened jobs, to discard late answers for an earlier one. */
export const openings = () => opened;

/** Take a job as a whole: from an example, a file or the text `toml`; one that was changed since it was `written` keeps the
    remarks of that. `fresh` forgets what could be undone; the same job in other words was `typed`. */
export function takeJob({ job, toml, written = "", title, errors = [], fresh = true, typed = false }) {
  if (!typed) {
    opened += 1;
    reading += 1; // discard pending answers for the earlier job
    forgetText();
  }
  if (fresh) past.length = future.length = 0;
  else remember("whole job");
  base = toml === undefined ? { job: null, toml: written } : { job, toml };
  set({ job, errors, ...(toml === undefined ? {} : { toml }), ...(title === undefined ? {} : { title }) });
  checkSoon(0);
  if (toml === undefined) writeSoon();
}

function remember(key) {
  const now = Date.now();
  // Typing in one field is one undo step.
  if (key !== lastEdit.key || now - lastEdit.when > 1500) {
    past.push({ job: state.job, base });
    if (past.length > STEPS_BACK) past.shift();
  }
  lastEdit = { key, when: now };
  future.length = 0;
}

function edit(path, value) {
  forgetText();
  remember(path.join("."));
  set({ job: setAt(state.job ?? {}, path, value) });
  checkSoon();
  writeSoon();
}

function step(from, to) {
  if (!from.length) return;
  forgetText();
  to.push({ job: state.job, base });
  lastEdit = { key: "", when: 0 };
  // With the job comes the text that it had then, so remarks that went with a table come back.
  const { job, base: before } = from.pop();
  base = before;
  set({ job, ...(base.job === job ? { toml: base.toml } : {}) });
  checkSoon(0);
  writeSoon();
}

export const undo = () => step(past, future);
export const redo = () => step(future, past);

/** A copy with one value changed; undefined takes the key away, and the tables that this leaves empty. */
function setAt(data, [key, ...rest], value) {
  if (key === undefined) return value;
  const list = Array.isArray(data) || (data === undefined && typeof key === "number");
  const copy = list ? [...(data ?? [])] : { ...data };
  const inner = rest.length ? setAt(copy[key], rest, value) : value;
  const empty = inner === undefined || (rest.length && isTable(inner) && !Object.keys(inner).length && !list);
  if (empty && list && rest.length === 0) copy.splice(key, 1);
  else if (empty) delete copy[key];
  else copy[key] = inner;
  return copy;
}

const isTable = (value) => value !== null && typeof value === "object" && !Array.isArray(value);

// ------------------------------------------------------------------------------------------ the server's word on it

let checkTimer = 0;
let checking = null;
let changed = -REST;
let unchecked = ""; // message why the job could not be checked

/** Check the current job; pending checks of an earlier one are discarded. */
export function checkSoon(pause = performance.now() - changed > REST ? 0 : CHECK_DELAY) {
  changed = performance.now();
  clearTimeout(checkTimer);
  checking?.abort();
  if (state.job) set({ checking: true });
  checkTimer = setTimeout(checkNow, pause);
}

async function checkNow() {
  checking?.abort();
  const mine = (checking = new AbortController());
  if (!state.job) return;
  set({ checking: true });
  try {
    const answer = await post("/job/check", { data: state.job, client: CLIENT }, { signal: mine.signal });
    set({ errors: answer.errors, checking: false, ...(answer.access ? { check: answer } : {}) });
    // The server can check the job again.
    if (unchecked && state.notice?.sentence === unchecked) say("");
    unchecked = "";
  } catch (error) {
    // A later request replaced this one.
    if (error.name === "AbortError" || mine !== checking) return;
    if (error.status === 409) {
      checkSoon(CHECK_DELAY);
      return;
    }
    // The last check was of another job.
    set({ checking: false, check: null });
    unchecked = error.message;
    say(unchecked, "bad");
  }
}

let writeTimer = 0;

function writeSoon() {
  clearTimeout(writeTimer);
  writeTimer = setTimeout(() => writeNow().catch((error) => say(error.message, "bad")), PAUSE_TOML);
}

/** Write the job of the form as text; later changes are written afterwards. */
async function writeNow() {
  clearTimeout(writeTimer);
  const { job } = state;
  if (!job || base.job === job) return;
  const before = base;
  const { toml, errors } = await post("/job/write", { data: job, toml: before.toml });
  if (!toml) throw new Error(errors[0]?.sentence ?? "The job cannot be written as TOML.");
  if (job !== state.job || before !== base) return;
  base = { job, toml };
  set({ toml });
}

/** The job as text, after pending reads and writes. */
export async function currentToml() {
  await settled();
  while (base.job !== state.job) await writeNow();
  return state.toml;
}

/** Whether the job names files. */
export function namesFiles(value = state.job) {
  if (typeof value === "string") return KEPT_FILE.test(value);
  return value !== null && typeof value === "object" && Object.values(value).some((one) => namesFiles(one));
}

let reading = 0;
let unread = null; // text that was typed and not read yet: {text, timer}

/** Parse text shortly after the last key. */
function readSoon(text) {
  clearTimeout(unread?.timer);
  unread = { text, timer: setTimeout(() => settled().catch((error) => say(error.message, "bad")), PAUSE_TOML) };
}

let settling = Promise.resolve();

/** Wait until the typed text is parsed; rejects if the server could not parse it. */
export function settled() {
  if (unread) {
    const mine = unread;
    clearTimeout(mine.timer);
    unread = null;
    const now = opened;
    settling = settling.catch(() => {}).then(() => readToml(mine.text)).catch((error) => {
      if (now !== opened) return;
      unread ??= mine;
      throw error;
    });
  }
  return settling;
}

/** Discard text that is not yet parsed, because the job changed elsewhere. */
function forgetText() {
  if (!unread) return;
  clearTimeout(unread.timer);
  unread = null;
  settling = Promise.resolve();
}

/** Parse the text of a job file into the form; returns the reason if it is not a job, which stays unchanged. */
export async function readToml(text, { title, fresh = false } = {}) {
  const mine = (reading += 1);
  const { data, errors = [] } = await post("/job/parse", { toml: text });
  // What was typed or opened since counts.
  if (mine !== reading) return "";
  if (!Object.keys(data).length) {
    if (!fresh) set({ errors, toml: text });
    return errors[0]?.sentence ?? "this is not a job file.";
  }
  takeJob({ job: data, toml: text, title, errors, fresh, typed: !fresh });
  return "";
}

// ----------------------------------------------------------------------------------------------- reading the schema

function resolve(node) {
  let found = node ?? {};
  while (found.$ref || found.allOf?.length === 1) {
    const { $ref, allOf, ...own } = found;
    const next = $ref ? $ref.slice(2).split("/").reduce((at, key) => at[key], state.schema) : allOf[0];
    found = { ...next, ...own };
  }
  const options = found.anyOf ?? found.oneOf;
  if (!options) return found;
  const values = options.filter((option) => option.type !== "null");
  if (values.length === 1) {
    const { anyOf, oneOf, ...own } = found;
    const only = resolve(values[0]);
    return { ...only, ...own, title: own.title ?? only.title, description: own.description ?? only.description };
  }
  return found;
}

/** The tables among which a key chooses: {key, options: {value: node}}, or null. */
function unionOf(node) {
  const options = (node.oneOf ?? node.anyOf ?? []).map(resolve).filter((option) => option.type !== "null");
  for (const option of options) {
    const deeper = option.properties ? null : unionOf(option);
    if (deeper) return deeper;
  }
  const tables = options.filter((option) => option.properties);
  if (!tables.length) return null;
  const named = (table, key) => constOf(resolve(table.properties[key]));
  const key = node.discriminator?.propertyName
    ?? Object.keys(tables[0].properties).find((name) => tables.every((table) => table.properties[name] && named(table, name) !== undefined));
  if (!key) return null;
  return { key, options: Object.fromEntries(tables.map((table) => [named(table, key), table])) };
}

function constOf(node) {
  if (node.const !== undefined) return node.const;
  return node.enum?.length === 1 ? node.enum[0] : undefined;
}

function kindOf(node) {
  if (unionOf(node)) return "union";
  if (node.enum) return "choice";
  if (node.type === "boolean") return "switch";
  if (node.properties) return "table";
  if (node.type === "object") return "map";
  if (node.type === "array") {
    if (node.prefixItems) return "tuple";
    const items = resolve(node.items ?? {});
    if (items.enum) return "choices";
    if (items.properties || unionOf(items)) return "list";
    return items.type === "array" ? "rows" : "series";
  }
  return "text";
}

const BLOCKS = new Set(["table", "union", "list", "map"]);

function plain(key) {
  const text = String(key).replaceAll("_", " ");
  return text.charAt(0).toUpperCase() + text.slice(1);
}

const titleOf = (node, key) => plain(node.title && !/table$/i.test(node.title) ? node.title : key);
const shownUnit = (node) => node.display ?? node.unit ?? "";

function defaultText(node) {
  const value = node.default;
  if (value === undefined || value === null || (isTable(value) && !Object.keys(value).length)) return "";
  if (Array.isArray(value)) return value.every((one) => typeof one !== "object") ? value.join(", ") : "";
  return typeof value === "object" ? "" : String(value);
}

// ------------------------------------------------------------------------------------------------------- the errors

/** The path of an error with indices from 0; the server counts from 1. */
const normal = (field) => String(field ?? "").replace(/\[(\d+)\]/g, (_, place) => `.${place - 1}`).replace(/^\./, "");

function errorsAt(path) {
  const here = path.join(".");
  return state.errors.filter((error) => normal(error.field) === here).map(sentenceOf);
}

/** The message without the field name, since it is shown at the field. */
function sentenceOf({ field, sentence }) {
  const rest = field && sentence.startsWith(field) ? sentence.slice(field.length) : "";
  return /^:? /.test(rest) ? rest.replace(/^:? /, "") : sentence;
}

/** Errors at or below a path. */
function errorsWithin(path) {
  const here = path.join(".");
  return state.errors.filter((error) => normal(error.field) === here || normal(error.field).startsWith(`${here}.`));
}

function Wrong({ id, sentences }) {
  if (!sentences.length) return null;
  return html`<p class="wrong" id=${id}>${sentences.map((sentence) => html`<span>${sentence}</span>`)}</p>`;
}

// ----------------------------------------------------------------------------------------------- what a field means

/** Drawings of the documentation, by the fields that they explain; the first match is shown. */
const DRAWINGS = [
  [/^(actual\.)?tool\.(nose_radius|included|rake|clearance|radius_error)/, "nose", "The nose: radius, included angle, rake and clearance"],
  [/^(actual\.)?tool\.offset/, "ogive", "Signature of an off-centre tool: ogive and core"],
  [/^(actual\.)?tool\.waviness/, "waviness", "Waviness of the edge"],
  [/^(strategy|passes\.\d+)\.(plan\.)?(feed|scallop)$/, "cusp", "Cusp and feed"],
  [/^(strategy\.(plan\.)?along|strategy\.(off_path|x_motion))$/, "placing", "Placing the edge along z and along the normal"],
  [/^part\.material/, "ductile", "Where the chip exceeds the critical thickness"],
  [/^passes\.\d+\.(depth|allowance)$/, "chip", "Uncut chip thickness of a round nose"],
  [/^(actual\.)?machine|^strategy\.(plan\.)?(sense|inside_out)$|^program\b/, "machine_frame", "Axes and signs of lathe and part"],
  [/^measurement\b/, "loop", "From the measured part to the corrected job"],
];

function Drawing({ path }) {
  const dialog = useRef(null);
  const here = path.join(".");
  const [, name, title] = DRAWINGS.find(([fields]) => fields.test(here)) ?? [];
  if (!name) return null;
  return html`<${Fragment}>
    <button type="button" class="drawing" title="Enlarge the drawing" aria-label=${`Enlarge: ${title}`} onClick=${() => dialog.current.showModal()}><img src=${`drawings/${name}.svg`} alt="" /></button>
    <dialog ref=${dialog} aria-label=${title}><header><h2>${title}</h2><span class="gap"></span><${Tool} icon="close" name="Close" onClick=${() => dialog.current.close()} /></header>
      <img src=${`drawings/${name}.svg`} alt="" /></dialog>
  </${Fragment}>`;
}

let explain = () => {};

function explaining(node, path) {
  const show = () => explain({ node, path });
  return { onFocusIn: show, onPointerEnter: show };
}

function Explained() {
  const [field, setField] = useState(null);
  useEffect(() => {
    explain = setField;
    return () => (explain = () => {});
  }, []);
  if (!field) {
    return html`<aside class="explain" aria-label="About the field" tabindex="0" aria-live="off"><p class="quiet">Point at a field or focus it with Tab to see its description.</p></aside>`;
  }
  const { node, path } = field;
  const unit = shownUnit(node);
  const text = defaultText(node);
  return html`<aside class="explain" id="explained" aria-label="About the field" tabindex="0" aria-live="off">
    <${Drawing} key=${path.join(".")} path=${path} />
    <h3>${titleOf(node, path.at(-1))} ${unit && html`<span class="unit">[${unit}]</span>`}</h3>
    ${node.description && html`<p>${node.description}</p>`}
    ${node.holds && html`<p>Upload a file (${node.endings.join(", ")}) with the button next to the field; it is saved with the job.</p>`}
    <p class="quiet"><code>${path.map((key) => (typeof key === "number" ? key + 1 : key)).join(".")}</code>${text && html` · default: ${text}`}</p>
  </aside>`;
}

// ------------------------------------------------------------------------------------------------------- the fields

const idOf = (path) => `field-${path.join("-").replace(/[^A-Za-z0-9-]/g, "_")}`;
const NUMBER = /^[-+−]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i;

/** The value of a text; a number alone gets the unit of the field. */
function readText(text, node) {
  const typed = text.trim().replace("−", "-");
  if (typed === "") return undefined;
  const unit = shownUnit(node);
  if (unit && NUMBER.test(typed)) return `${typed} ${unit}`;
  if (unit) return typed;
  const options = node.anyOf ?? node.oneOf;
  if (node.type === "number" || node.type === "integer" || options) {
    if (NUMBER.test(typed)) return Number(typed);
    if (options && typed.includes(",")) return typed.split(",").map((part) => part.trim());
  }
  return typed;
}

function showValue(value) {
  if (value === undefined || value === null) return "";
  return Array.isArray(value) ? value.join(", ") : typeof value === "object" ? JSON.stringify(value) : String(value);
}

/** The text with the last digit of its first number stepped up or down. */
function nudged(text, steps) {
  const match = /[-+−]?\d*\.?\d+(?:e[-+]?\d+)?/i.exec(text);
  if (!match) return text;
  const [mantissa, power = ""] = match[0].replace("−", "-").split(/(?=e)/i);
  const decimals = mantissa.split(".")[1]?.length ?? 0;
  const moved = (Number(mantissa) + steps * 10 ** -decimals).toFixed(decimals);
  return text.slice(0, match.index) + moved + power + text.slice(match.index + match[0].length);
}

/** Typed text stays as it is; a value from elsewhere replaces it. `take(typed)` returns the value of the text.

    The comparison belongs to the drawing itself: an effect runs after later keys, and would write an earlier value back. */
function useTyped(value, take, shown = showValue) {
  const [text, write] = useState(shown(value));
  const typedValue = useRef(value);
  const drawn = useRef(shown(value));
  if (shown(value) !== drawn.current) {
    drawn.current = shown(value);
    if (drawn.current !== shown(typedValue.current)) {
      typedValue.current = value;
      write(drawn.current);
    }
  }
  const type = (typed) => {
    write(typed);
    typedValue.current = take(typed);
  };
  return { text, type, settle: () => write(shown(typedValue.current)) };
}

/** A text box; the arrow keys step its last digit. */
function Box({ node, path, value, change, label, wrong, hint, list, describedBy, read = (typed) => readText(typed, node) }) {
  const { text, type, settle } = useTyped(value, (typed) => {
    const meaning = read(typed);
    change(meaning);
    return meaning;
  });
  const keys = (event) => {
    const steps = { ArrowUp: 1, ArrowDown: -1 }[event.key];
    if (!steps || list || !/\d/.test(text)) return;
    event.preventDefault();
    type(nudged(text, steps * (event.shiftKey ? 10 : 1)));
  };
  return html`<input id=${idOf(path)} type="text" autocomplete="off" spellcheck=${false} value=${text} placeholder=${hint} list=${list}
    aria-label=${label} aria-invalid=${wrong ? "true" : null} aria-describedby=${describedBy}
    onInput=${(event) => type(event.target.value)} onKeyDown=${keys} onBlur=${settle} />`;
}

/** A text area for several values or rows. */
function Lines({ path, value, read, shown, rows, hint, wrong }) {
  const { text, type } = useTyped(value, (typed) => {
    const found = read(typed);
    edit(path, found);
    return found;
  }, shown);
  return html`<textarea id=${idOf(path)} rows=${rows(text)} spellcheck=${false} value=${text} placeholder=${hint}
    aria-invalid=${wrong ? "true" : null} onInput=${(event) => type(event.target.value)} />`;
}

/** A list to choose from; the first row is for no choice, if it has a label. */
function Select({ path, options, chosen, none, wrong = false, choose }) {
  return html`<select id=${idOf(path)} aria-invalid=${wrong ? "true" : null}
    onChange=${(event) => choose(event.target.value === "" ? undefined : options[Number(event.target.value)])}>
    ${none !== null && html`<option value="" selected=${!options.includes(chosen)}>${none}</option>`}
    ${options.map((option, index) => html`<option value=${index} selected=${option === chosen}>${String(option)}</option>`)}
  </select>`;
}

/** A field with label, input and errors. The label belongs to the box `of`; null if several boxes make one value. */
function Row({ node, path, required, children, wide = false, of = path, kind = "", wrong = errorsAt(path), explained = node }) {
  const title = titleOf(node, path.at(-1));
  const name = html`${title}${required && html`<span class="needed" title="required" aria-hidden="true">•</span>`}`;
  return html`<div class=${`field${wide ? " wide" : ""}${wrong.length ? " bad" : ""}`} ...${explaining(explained, path)} ...${of === path ? {} : { role: "group", "aria-label": title }}>
    ${of ? html`<label for=${idOf(of)}>${name}</label>` : html`<span class="label">${name}</span>`}
    <div class=${`value ${kind}`}>${children}</div>
    <${Wrong} id=${`${idOf(path)}-wrong`} sentences=${wrong} />
  </div>`;
}

const sentencesWithin = (path) => errorsWithin(path).map(sentenceOf);

function Text({ node, path, value, required }) {
  const known = node.examples?.length ? `${idOf(path)}-known` : null;
  const wrong = errorsAt(path).length > 0;
  return html`<${Row} node=${node} path=${path} required=${required}>
    <${Box} node=${node} path=${path} value=${value} change=${(read) => edit(path, read)} label=${titleOf(node, path.at(-1))} wrong=${wrong} list=${known}
      hint=${defaultText(node) || shownUnit(node)} describedBy=${wrong ? `${idOf(path)}-wrong` : "explained"} />
    ${known && html`<datalist id=${known}>${node.examples.map((one) => html`<option value=${String(one)} />`)}</datalist>`}
    ${node.holds && html`<${Bring} node=${node} path=${path} />`}
  </${Row}>`;
}

const KEPT_FILE = /^(files|runs|examples)\/.*?([^/]+)$/;
const FROM = { files: "uploaded", runs: "from a run", examples: "from an example" };

/** A file that the job names: uploaded here, or stored on the server. */
function Named({ node, path, value, required }) {
  const [, where, name] = KEPT_FILE.exec(value ?? "") ?? [];
  if (!name) return html`<${Text} node=${node} path=${path} value=${value} required=${required} />`;
  return html`<${Row} node=${node} path=${path} required=${required}>
    <output id=${idOf(path)} class="file" title=${`${name}, ${FROM[where]}`}>${name}</output>
    <${Bring} node=${node} path=${path} />
    <${Tool} icon="close" name=${`Remove ${name} from the job`} onClick=${() => edit(path, undefined)} />
  </${Row}>`;
}

/** Upload of a file for a field. */
function Bring({ node, path }) {
  const [share, setShare] = useState(null);
  const picker = useRef(null);
  const take = async (file) => {
    const most = state.about?.limits.file_bytes ?? Infinity;
    if (file.size > most) return say(`${file.name} has ${Math.ceil(file.size / 2 ** 20)} MiB, the limit is ${most / 2 ** 20} MiB.`, "bad");
    setShare(0);
    const mine = opened;
    try {
      const { reference } = await upload("/files", { kind: node.holds, name: file.name }, file, (sent, total) => setShare(sent / total));
      // The upload was for an earlier job.
      if (mine !== opened) return;
      edit(path, reference);
      say("");
    } catch (error) {
      say(`${file.name}: ${error.message}`, "bad");
    } finally {
      setShare(null);
    }
  };
  return html`<${Fragment}>
    <input ref=${picker} id=${`${idOf(path)}-file`} type="file" hidden accept=${node.endings.join(",")} aria-label=${`File for ${titleOf(node, path.at(-1))}`}
      onChange=${(event) => { if (event.target.files[0]) take(event.target.files[0]); event.target.value = ""; }} />
    <${Tool} icon="open" name=${share === null ? `Upload a file (${node.endings.join(", ")})` : `Uploading, ${Math.round(100 * share)} %`}
      disabled=${share !== null} onClick=${() => picker.current.click()} />
  </${Fragment}>`;
}

function Choice({ node, path, value, required }) {
  const unset = defaultText(node);
  const none = value !== undefined && required ? null : unset ? `${unset} (default)` : required ? "choose" : "–";
  return html`<${Row} node=${node} path=${path} required=${required}>
    <${Select} path=${path} options=${node.enum} chosen=${value} none=${none} wrong=${errorsAt(path).length > 0} choose=${(option) => edit(path, option)} />
  </${Row}>`;
}

function Switch({ node, path, value }) {
  const on_ = value ?? node.default ?? false;
  return html`<${Row} node=${node} path=${path}>
    <span class="switch"><input id=${idOf(path)} type="checkbox" role="switch" checked=${on_}
      onChange=${(event) => edit(path, event.target.checked)} /><span aria-hidden="true">${on_ ? "yes" : "no"}</span></span>
  </${Row}>`;
}

/** Several boxes that make one value. */
function Tuple({ node, path, value, required }) {
  const items = node.prefixItems.map(resolve);
  const letters = items.length <= 3 && items.every((item) => item.title === undefined) ? ["x", "y", "z"] : items.map((_, index) => index + 1);
  const change = (index, one) => {
    const list = items.map((_, at) => value?.[at] ?? "");
    list[index] = one ?? "";
    edit(path, list.every((entry) => entry === "") ? undefined : list);
  };
  const places = items.map((_, index) => [...path, index]);
  return html`<${Row} node=${node} path=${path} required=${required} wide=${items.length > 2} of=${places[0]} kind="many" wrong=${[path, ...places].flatMap(errorsAt)}>
    ${items.map((item, index) => html`<${Box} key=${index} node=${item} path=${places[index]} value=${value?.[index]} change=${(one) => change(index, one)}
      label=${`${titleOf(node, path.at(-1))} ${letters[index]}`} hint=${`${letters[index]} ${shownUnit(item)}`} wrong=${errorsAt(places[index]).length > 0} />`)}
  </${Row}>`;
}

const numberOr = (text) => {
  const typed = text.trim().replaceAll("−", "-");
  return NUMBER.test(typed) ? Number(typed) : text.trim();
};

/** Values separated by commas. */
function Series({ node, path, value, required }) {
  const wrong = sentencesWithin(path);
  const read = (typed) => {
    const parts = typed.split(/[,\n]/).map(numberOr).filter((part) => part !== "");
    return parts.length ? parts : undefined;
  };
  return html`<${Row} node=${node} path=${path} required=${required} wide wrong=${wrong} explained=${{ ...node, unit: shownUnit(resolve(node.items)) }}>
    <${Lines} path=${path} value=${value} read=${read} rows=${(text) => Math.min(4, 1 + Math.floor(text.length / 33))} hint="values separated by commas" wrong=${wrong.length > 0} />
  </${Row}>`;
}

/** Rows of values, one per line. */
function Rows({ node, path, value, required }) {
  const wrong = sentencesWithin(path);
  const columns = (resolve(node.items).prefixItems ?? []).map((one) => shownUnit(resolve(one)) || "number");
  const shown = (rows) => (rows ?? []).map(showValue).join("\n");
  const read = (typed) => {
    const rows = typed.split("\n").filter((line) => line.trim());
    return rows.length ? rows.map((line) => line.split(",").map(numberOr)) : undefined;
  };
  return html`<${Row} node=${node} path=${path} required=${required} wide wrong=${wrong}>
    <${Lines} path=${path} value=${value} read=${read} shown=${shown} rows=${(text) => Math.min(6, Math.max(2, text.split("\n").length))} hint=${`one per line: ${columns.join(", ")}`} wrong=${wrong.length > 0} />
  </${Row}>`;
}

/** Several of a few words. */
function Choices({ node, path, value }) {
  const options = resolve(node.items).enum;
  const chosen = new Set(value ?? (Array.isArray(node.default) ? node.default : []));
  const flip = (option) => {
    const next = options.filter((one) => (one === option ? !chosen.has(one) : chosen.has(one)));
    edit(path, next.length ? next : undefined);
  };
  return html`<${Row} node=${node} path=${path} wide of=${null} kind="flags" wrong=${sentencesWithin(path)}>
    ${options.map((option) => html`<label class="flag"><input type="checkbox" checked=${chosen.has(option)} onChange=${() => flip(option)} />${String(option)}</label>`)}
  </${Row}>`;
}

/** The name of a term is committed when its box loses focus. */
function TermName({ name, label, rename }) {
  const [draft, write] = useState(null);
  const leave = () => {
    const typed = draft?.trim();
    write(null);
    if (typed !== undefined && typed !== name) rename(typed);
  };
  return html`<input type="text" value=${draft ?? name} aria-label=${label} onInput=${(event) => write(event.target.value)} onBlur=${leave} />`;
}

/** Named values: the terms of a series, the constants of a formula. */
function Terms({ node, path, value, required }) {
  const entries = Object.entries(value ?? {});
  const item = resolve(typeof node.additionalProperties === "object" ? node.additionalProperties : Object.values(node.patternProperties ?? {})[0] ?? {});
  const write = (list) => edit(path, list.length ? Object.fromEntries(list) : undefined);
  const rename = (index, name) => {
    // A duplicate name would replace the other term.
    if (entries.some(([key], at) => at !== index && key === name)) {
      say(`A term named ${name} already exists.`, "bad");
    } else write(entries.map((entry, at) => (at === index ? [name, entry[1]] : entry)));
  };
  return html`<${Row} node=${node} path=${path} required=${required} wide of=${null} kind="terms" wrong=${sentencesWithin(path)}>
    ${entries.map(([key, one], index) => html`<div class="term" key=${index}>
      <${TermName} name=${key} label=${`name of term ${index + 1}`} rename=${(name) => rename(index, name)} />
      <${Box} node=${item} path=${[...path, key]} value=${one} label=${`value of ${key}`} hint=${shownUnit(item)} wrong=${errorsWithin([...path, key]).length > 0}
        read=${numberOr} change=${(meaning) => write(entries.map((entry, at) => (at === index ? [key, meaning] : entry)))} />
      <${Tool} icon="close" name=${`Remove ${key}`} onClick=${() => write(entries.filter((_, at) => at !== index))} />
    </div>`)}
    <button type="button" class="add" onClick=${() => write([...entries, [freeKey(value), ""]])}><${Icon} name="plus" />Add a term</button>
  </${Row}>`;
}

function freeKey(value) {
  let index = 1;
  while (value && String(index) in value) index += 1;
  return String(index);
}

const FIELDS = { choice: Choice, switch: Switch, tuple: Tuple, series: Series, rows: Rows, choices: Choices, map: Terms, union: Union, list: List, table: Sub, text: Text };

function Field({ node: raw, path, value, required }) {
  const node = resolve(raw);
  if (constOf(node) !== undefined) return null;
  const Kind = node.holds ? Named : FIELDS[kindOf(node)];
  return html`<${Kind} node=${node} path=${path} value=${value} required=${required} />`;
}

const isApart = (node) => BLOCKS.has(kindOf(node)) || node.format === "reference";

/** The fields of a table: required or stated ones, the others on demand. */
function Fields({ node, path, value, skip }) {
  const [all, showAll] = useState(false);
  const needed = new Set(node.required ?? []);
  const names = Object.keys(node.properties).filter((name) => name !== skip && constOf(resolve(node.properties[name])) === undefined);
  // The name comes first, nested tables last.
  const rank = (name) => (name === "name" ? 0 : BLOCKS.has(kindOf(resolve(node.properties[name]))) && name !== "surface" ? 2 : 1);
  names.sort((a, b) => rank(a) - rank(b));
  // An emptied field stays visible while it is edited.
  const met = useRef({ opened, names: new Set() });
  if (met.current.opened !== opened) met.current = { opened, names: new Set() };
  const stated = (name) => needed.has(name) || kindOf(resolve(node.properties[name])) === "list" || value?.[name] !== undefined || errorsWithin([...path, name]).length > 0 || met.current.names.has(name);
  // A single hidden field is shown instead.
  const rest = names.filter((name) => !stated(name));
  const few = rest.length === 1 && !isApart(resolve(node.properties[rest[0]]));
  const shown = names.filter((name) => all || few || stated(name));
  if (!all) shown.forEach((name) => met.current.names.add(name));
  const hidden = names.length - shown.length;
  return html`<${Fragment}>
    ${shown.map((name) => html`<${Field} key=${name} node=${node.properties[name]} path=${[...path, name]} value=${value?.[name]} required=${needed.has(name)} />`)}
    ${(hidden > 0 || all) && html`<button type="button" class="more" aria-expanded=${all ? "true" : "false"} onClick=${() => showAll(!all)}>
      <${Icon} name=${all ? "up" : "down"} /><span>${all ? "Only what is stated" : `${hidden} more: ${names.filter((name) => !shown.includes(name)).map((name) => plain(name).toLowerCase()).join(", ")}`}</span>
    </button>`}
  </${Fragment}>`;
}

/** A table within a table. */
function Sub({ node, path, value }) {
  return html`<div class="sub" role="group" aria-label=${titleOf(node, path.at(-1))}>
    <h4 ...${explaining(node, path)}>${titleOf(node, path.at(-1))}</h4>
    <${Wrong} id=${`${idOf(path)}-wrong`} sentences=${errorsAt(path)} />
    <${Fields} node=${node} path=${path} value=${value} />
  </div>`;
}

/** A table of one of several families: a change keeps the common fields. */
function Union({ node, path, value, required, bare = false }) {
  const { key, options } = unionOf(node);
  if (Array.isArray(value)) {
    return html`<${List} node=${{ ...node, type: "array", items: node }} path=${path} value=${value} />`;
  }
  const chosen = options[value?.[key]];
  const swap = (name) => {
    if (!name) return edit(path, undefined);
    const fields = options[name].properties;
    const kept = Object.entries(isTable(value) ? value : {}).filter(([field]) => field in fields && field !== key);
    return edit(path, { [key]: name, ...Object.fromEntries(kept) });
  };
  const choice = resolve(chosen?.properties?.[key] ?? {});
  const about = { ...node, title: plain(key), description: chosen?.description ?? choice.description ?? node.description };
  const body = html`<${Fragment}>
    <${Row} node=${about} path=${[...path, key]} required=${required} wrong=${[...errorsAt(path), ...errorsAt([...path, key])]}>
      <${Select} path=${[...path, key]} options=${Object.keys(options)} chosen=${value?.[key]} none=${required && chosen ? null : required ? "choose" : "–"} choose=${swap} />
    </${Row}>
    ${chosen && html`<${Fields} key=${value[key]} node=${chosen} path=${path} value=${value} skip=${key} />`}
  </${Fragment}>`;
  if (bare) return body;
  return html`<div class="sub" role="group" aria-label=${titleOf(node, path.at(-1))}><h4 ...${explaining(about, path)}>${plain(path.at(-1))}</h4>${body}</div>`;
}

/** Tables in order: passes, patches, terms of a sum. */
function List({ node, path, value }) {
  const item = resolve(node.items);
  const rows = value ?? [];
  const one = plain(path.at(-1)).toLowerCase().replace(/(ss|ch)es$|s$/, "$1");
  const move = (from, to) => {
    const next = [...rows];
    next.splice(to, 0, ...next.splice(from, 1));
    edit(path, next);
  };
  const begin = () => {
    const last = rows.at(-1);
    return edit(path, [...rows, last === undefined ? FIRST[path.join(".")] ?? {} : "name" in last ? { ...last, name: `${last.name} ${rows.length + 1}`.slice(0, 30) } : { ...last }]);
  };
  return html`<div class="list">
    <${Wrong} id=${`${idOf(path)}-wrong`} sentences=${errorsAt(path)} />
    ${!rows.length && html`<p class="quiet">${NONE_YET[path.join(".")] ?? "None."}</p>`}
    ${rows.map((row, index) => html`<div class="item" key=${index}>
      <div class="head"><span>${row?.name || `${plain(one)} ${index + 1}`}</span>
        <${Tool} icon="up" name=${`Move ${one} ${index + 1} up`} disabled=${index === 0} onClick=${() => move(index, index - 1)} />
        <${Tool} icon="down" name=${`Move ${one} ${index + 1} down`} disabled=${index === rows.length - 1} onClick=${() => move(index, index + 1)} />
        <${Tool} icon="bin" name=${`Remove ${one} ${index + 1}`} onClick=${() => edit(path, rows.length > 1 ? rows.filter((_, at) => at !== index) : undefined)} />
      </div>
      <${Wrong} id=${`${idOf([...path, index])}-wrong`} sentences=${errorsAt([...path, index])} />
      ${unionOf(item)
        ? html`<${Union} node=${item} path=${[...path, index]} value=${row} required bare />`
        : html`<${Fields} node=${item} path=${[...path, index]} value=${row} />`}
    </div>`)}
    <button type="button" class="add" onClick=${begin}><${Icon} name="plus" />Add a ${one}</button>
  </div>`;
}

// ------------------------------------------------------------------------------------------------------- the groups

/** Summary of a folded group. */
function summary(node, value) {
  if (value === undefined) return "default";
  if (Array.isArray(value)) return value.length === 0 ? "none" : value.map((one) => one?.name ?? (typeof one === "string" ? one : "")).filter(Boolean).join(", ") || String(value.length);
  if (!isTable(value)) return showValue(value);
  return Object.values(value).filter((one) => typeof one === "string" || typeof one === "number").slice(0, 3).join(" · ");
}

function Group({ name, node: raw, value, required }) {
  const node = resolve(raw);
  const [open, setOpen] = useState(OPEN_AT_FIRST.has(name));
  const path = [name];
  const wrong = errorsWithin(path).length;
  const kind = kindOf(node);
  const given = { node, path, value, required };
  return html`<details class="group" open=${open} onToggle=${(event) => setOpen(event.target.open)}>
    <summary ...${explaining(node, path)}>
      <span class="name">${plain(name)}</span>
      <span class="gist">${open ? "" : summary(node, value)}</span>
      ${wrong > 0 && html`<span class="count" aria-label=${`${wrong} errors`}>${wrong}</span>`}
    </summary>
    ${open && html`<div class="fields">
      ${kind === "table" && html`<${Fragment}><${Wrong} id=${`${idOf(path)}-wrong`} sentences=${errorsAt(path)} /><${Fields} ...${given} /></${Fragment}>`}
      ${kind === "union" && html`<${Union} ...${given} bare />`}
      ${kind !== "table" && kind !== "union" && html`<${Field} ...${given} />`}
    </div>`}
  </details>`;
}

function Fieldset() {
  const { job, schema, errors } = useStore(["job", "schema", "errors"]);
  if (!schema) return html`<p class="quiet pad">Loading the job schema …</p>`;
  if (!job) {
    return html`<div class="pad quiet"><p>No job yet. Choose an example, open a job file or start with a new one to edit its fields here.</p></div>`;
  }
  const root = resolve(schema);
  const needed = new Set(root.required ?? []);
  const tops = new Set(Object.keys(root.properties));
  const homeless = errors.filter((error) => !tops.has(normal(error.field).split(".")[0]));
  return html`<div class="groups">
    ${homeless.length > 0 && html`<div class="pad"><${Wrong} id="job-wrong" sentences=${homeless.map((error) => error.sentence)} /></div>`}
    ${Object.entries(root.properties).map(([name, node]) => html`<${Group} key=${name} name=${name} node=${node} value=${job[name]} required=${needed.has(name)} />`)}
  </div>`;
}

// --------------------------------------------------------------------------------------------------------- the text

function TextPane() {
  const { toml, job, errors } = useStore(["toml", "job", "errors"]);
  const [draft, setDraft] = useState(unread?.text ?? null);
  const change = (text) => {
    setDraft(text);
    readSoon(text);
  };
  // Keep the draft until it is the text of the page; otherwise losing focus would show the earlier text.
  const leave = () => settled().then(() => unread ?? setDraft(null), (error) => say(error.message, "bad"));
  useEffect(() => {
    if (!unread) setDraft(null);
  }, [job]);
  return html`<div class="toml">
    <textarea aria-label="The job as TOML" spellcheck=${false} autocapitalize="off" wrap="off" value=${draft ?? toml}
      placeholder=${job ? "" : "Paste a job file here."} onInput=${(event) => change(event.target.value)} onBlur=${leave} />
    ${errors.length > 0 && html`<div class="pad"><${Wrong} id="toml-wrong" sentences=${errors.map((error) => error.sentence)} /></div>`}
  </div>`;
}

// ---------------------------------------------------------------------------------------------------------- the pane

function Pane() {
  const [text, showText] = useState(false);
  const { job, errors } = useStore(["job", "errors"]);
  const tab = (name, chosen, choose) => html`<button type="button" role="tab" aria-selected=${chosen ? "true" : "false"} tabindex=${chosen ? 0 : -1} onClick=${choose}
    onKeyDown=${(event) => ["ArrowLeft", "ArrowRight"].includes(event.key) && showText(!text)}>${name}</button>`;
  return html`<${Fragment}>
    <div class="panehead">
      <div class="tabs" role="tablist" aria-label="The job as">${tab("Fields", !text, () => showText(false))}${tab("TOML", text, () => showText(true))}</div>
      <span class="gap"></span>
      ${errors.length > 0 && html`<span class="count" title=${errors.map((error) => error.sentence).join("\n")}>${errors.length} to correct</span>`}
      <${Tool} icon="undo" name="Undo" keys="Ctrl+Z" disabled=${!job || !past.length} onClick=${undo} />
      <${Tool} icon="redo" name="Redo" keys="Ctrl+Shift+Z" disabled=${!job || !future.length} onClick=${redo} />
    </div>
    <div class="scroll" role="region" tabindex="0" aria-label="Job">${text ? html`<${TextPane} />` : html`<${Fieldset} />`}</div>
    ${!text && job && html`<${Explained} />`}
  </${Fragment}>`;
}

export function mount(element) {
  render(html`<${Pane} />`, element);
  return { destroy: () => render(null, element) };
}
