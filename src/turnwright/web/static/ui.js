/* Shared parts of the panels: store hook, number formats, icons and downloads. */

import { html, useEffect, useState } from "./vendor/preact.js";
import { address } from "./api.js";
import { on, state } from "./state.js";

/** The store; the component is rendered again whenever one of `keys` changes. */
export function useStore(keys) {
  const [, again] = useState(0);
  useEffect(() => on(keys, () => again((count) => count + 1), { now: true }), []);
  return state;
}

const NONE = "–";
const GAP = "\u202f";

/** A number with `digits` significant digits, thousands separators and a true minus sign. */
export function number(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e7 || size < 1e-4) {
    const [mantissa, power] = value.toExponential(digits - 1).split("e");
    return `${mantissa.replace("-", "−")}·10${superscript(Number(power))}`;
  }
  const decimals = Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
  return whole(Number(value.toFixed(Math.min(decimals, 12))), Math.min(decimals, 12));
}

function superscript(power) {
  return [...String(power)].map((sign) => (sign === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(sign)])).join("");
}

function whole(value, decimals) {
  const [head, tail] = Math.abs(value).toFixed(decimals).split(".");
  const grouped = head.length > 4 ? head.replace(/\B(?=(\d{3})+$)/g, GAP) : head;
  return `${value < 0 ? "−" : ""}${grouped}${tail ? `.${tail}` : ""}`;
}

/** A count, in full. */
export function count(value) {
  return Number.isFinite(value) ? whole(value, 0) : NONE;
}

function scaled(value, steps, digits) {
  if (!Number.isFinite(value)) return NONE;
  const [factor, unit] = steps.find(([least]) => Math.abs(value) >= 1 / least) ?? steps.at(-1);
  return `${number(value * factor, digits)}${GAP}${unit}`;
}

/** A length in mm with the unit that suits it. */
export function length(value, digits = 3) {
  if (value === 0) return `0${GAP}mm`;
  if (!Number.isFinite(value)) return NONE;
  const size = Math.abs(value);
  if (size >= 0.1) return `${number(value, Math.max(digits, 3))}${GAP}mm`;
  return size >= 1e-4 ? `${number(value * 1e3, digits)}${GAP}µm` : `${number(value * 1e6, digits)}${GAP}nm`;
}

/** A height in nm with the unit that suits it. */
export function height(nanometres, digits = 3) {
  if (!Number.isFinite(nanometres)) return NONE;
  const size = Math.abs(nanometres);
  if (size >= 1e6) return `${number(nanometres / 1e6, digits)}${GAP}mm`;
  if (size >= 1e4) return `${number(nanometres / 1e3, digits)}${GAP}µm`;
  if (size < 1e-4) return `0${GAP}nm`;
  return `${number(nanometres, digits)}${GAP}nm`;
}

/** A value as the server states it, rad shown in a unit that suits it. */
export function quantity(value, unit, digits = 3) {
  if (unit === "mm") return length(value, digits);
  if (unit === "nm") return height(value, digits);
  if (unit === "rad") {
    const size = Math.abs(value);
    if (size < 1e-9) return "0°"; // of rounding alone
    if (size >= 2e-3) return `${number((value * 180) / Math.PI, digits)}°`;
    return size >= 1e-3 ? `${number(value * 1e3, digits)}${GAP}mrad` : `${number(value * 1e6, digits)}${GAP}µrad`;
  }
  return `${number(value, digits)}${unit ? GAP + unit : ""}`;
}

const SCALES = {
  mm: [[1, "mm"], [1e3, "µm"], [1e6, "nm"]],
  rad: [[180 / Math.PI, "°"], [1e3, "mrad"], [1e6, "µrad"]],
};

/** A value with its uncertainty in one unit, rounded to the uncertainty. */
export function doubted(value, doubt, unit) {
  if (!Number.isFinite(value)) return NONE;
  if (!Number.isFinite(doubt) || doubt <= 0) return Math.abs(value) < 1e-9 && unit in SCALES ? `0${GAP}${SCALES[unit].at(-1)[1]}` : quantity(value, unit);
  const size = Math.max(Math.abs(value), doubt);
  const steps = SCALES[unit] ?? [[1, unit]];
  const [factor, shown] = steps.find(([one]) => size * one >= 0.1) ?? steps.at(-1);
  const decimals = Math.min(6, Math.max(0, 1 - Math.floor(Math.log10(doubt * factor))));
  const text = whole(value * factor, decimals);
  return `${/[1-9]/.test(text) ? text : text.replace("−", "")} ± ${whole(doubt * factor, decimals)}${shown ? GAP + shown : ""}`;
}

/** A duration in h, min and s. */
export function duration(seconds) {
  if (!Number.isFinite(seconds)) return NONE;
  if (seconds < 1) return `${number(seconds * 1000, 2)}${GAP}ms`;
  if (seconds < 10) return `${seconds.toFixed(1)}${GAP}s`;
  const all = Math.round(seconds);
  const [hours, minutes, rest] = [Math.floor(all / 3600), Math.floor((all % 3600) / 60), all % 60];
  if (hours) return `${hours}${GAP}h ${String(minutes).padStart(2, "0")}${GAP}min`;
  return minutes ? `${minutes}${GAP}min ${String(rest).padStart(2, "0")}${GAP}s` : `${rest}${GAP}s`;
}

/** A size of a file. */
export function bytes(value) {
  return scaled(value, [[1e-9, "GB"], [1e-6, "MB"], [1e-3, "kB"], [1, "B"]], 3);
}

/** A fraction as a percentage. */
export function percent(share) {
  if (!Number.isFinite(share)) return NONE;
  const value = share * 100;
  return `${value >= 10 ? Math.round(value) : value >= 0.1 ? value.toFixed(1) : "<0.1"}${GAP}%`;
}

/** A time of day, with the date unless it is today. */
export function clock(when) {
  const date = typeof when === "number" ? new Date(when * 1000) : new Date(when);
  if (Number.isNaN(date.getTime())) return "";
  const today = new Date().toDateString() === date.toDateString();
  return date.toLocaleString("en-GB", {
    ...(today ? {} : { day: "numeric", month: "short" }),
    hour: "2-digit",
    minute: "2-digit",
  });
}

const PATHS = {
  open: "M2.5 12.5v-9h4l1.5 2h5.5v7z M2.5 7.5h11",
  save: "M8 2v8m0 0 3-3m-3 3-3-3M2.5 11v2.5h11V11",
  undo: "M6 3 3 6l3 3M3 6h6.5a3.5 3.5 0 0 1 0 7H6",
  redo: "m10 3 3 3-3 3m3-3H6.5a3.5 3.5 0 0 0 0 7H10",
  run: "M4.5 3v10l8-5z",
  compare: "M3 13V8m5 5V3m5 10V6",
  stop: "M4 4h8v8H4z",
  bin: "M3 4.5h10M6.5 4.5v-2h3v2M4.5 4.5l.6 9h5.8l.6-9",
  plus: "M8 3v10M3 8h10",
  up: "m4 10 4-4 4 4",
  down: "m4 6 4 4 4-4",
  close: "m4 4 8 8m0-8-8 8",
  sun: "M8 5.2a2.8 2.8 0 1 1 0 5.6 2.8 2.8 0 0 1 0-5.6M8 1.5v1.5m0 10v1.5M1.5 8H3m10 0h1.5M3.4 3.4l1 1m7.2 7.2 1 1m0-9.2-1 1m-7.2 7.2-1 1",
  moon: "M12.5 9.8A5.3 5.3 0 0 1 6.2 3.5a5.3 5.3 0 1 0 6.3 6.3",
  help: "M6 6a2 2 0 1 1 3 1.8c-.7.4-1 .8-1 1.7m0 2.3v.2M8 1.8a6.2 6.2 0 1 1 0 12.4A6.2 6.2 0 0 1 8 1.8",
  left: "M2.5 3h11v10h-11zM6.5 3v10",
  right: "M2.5 3h11v10h-11zM9.5 3v10",
  tall: "M2.5 3h11v10h-11zM2.5 6h11",
  place: "M8 1.5v3m0 7v3M1.5 8h3m7 0h3M8 5.5a2.5 2.5 0 1 1 0 5 2.5 2.5 0 0 1 0-5",
  yes: "m3.5 8.5 3 3 6-7",
  no: "m4.5 4.5 7 7m0-7-7 7",
  warn: "M8 2.5 14 13H2zM8 6.5v3m0 1.8v.2",
  idle: "M4 8h8",
};

/** A 16 px icon. */
export function Icon({ name }) {
  return html`<svg class="icon" viewBox="0 0 16 16" aria-hidden="true"><path d=${PATHS[name]} /></svg>`;
}

/** An icon button with an accessible name. */
export function Tool({ icon, name, keys = "", ...rest }) {
  const title = keys ? `${name}  (${keys})` : name;
  return html`<button type="button" class="tool" title=${title} aria-label=${name} ...${rest}><${Icon} name=${icon} /></button>`;
}

/** A verdict by shape and colour. */
export function Mark({ ok, warn = false }) {
  const kind = ok === null || ok === undefined ? "idle" : ok ? "yes" : warn ? "warn" : "no";
  const label = { yes: "met", no: "not met", warn: "warning", idle: "not evaluated" }[kind];
  return html`<span class=${`mark ${kind}`} role="img" aria-label=${label}><${Icon} name=${kind} /></span>`;
}

/** Utilisation of a limit as a bar; the limit is at 80 % of its width, so that an excess is visible. */
export function Gauge({ share, label, bad = share > 1 }) {
  const clipped = Math.max(0, Math.min(1.25, Number.isFinite(share) ? share : 0));
  return html`<svg class=${bad ? "gauge bad" : "gauge"} viewBox="0 0 100 4" preserveAspectRatio="none" role="meter"
    aria-label=${label} aria-valuemin="0" aria-valuemax="1.25" aria-valuenow=${clipped.toFixed(3)}>
    <rect class="track" width="100" height="4" />
    <rect class="fill" width=${clipped * 80} height="4" />
    <rect class="limit" x="79.6" width=".8" height="4" />
  </svg>`;
}

/** A fraction as a plain bar. */
export function Bar({ share, kind = "" }) {
  const width = Math.max(0, Math.min(1, Number.isFinite(share) ? share : 0)) * 100;
  return html`<svg class=${`share ${kind}`} viewBox="0 0 100 4" preserveAspectRatio="none" aria-hidden="true"><rect class="track" width="100" height="4" /><rect class="fill" width=${width} height="4" /></svg>`;
}

const FILES = { program: "Program", table: "Fast tool servo table", report: "Report", job: "Job", written: "Job as written", bundle: "Job with its files", correction: "Correction", archive: "Archive", result: "Numbers" };

/** Links to the files of a run: [{name, part, file, bytes}]; several of one kind are folded. */
export function Downloads({ path, files, only = Object.keys(FILES) }) {
  const link = ({ name, part, file, bytes: size }, title) => html`<a class="button" href=${address(`${path}/files/${name}`, part ? { part } : {})} download=${file} title=${`${file}, ${bytes(size)}`}><${Icon} name="save" />${title}</a>`;
  return html`<div class="downloads">
    ${only.map((kind) => {
      const these = files.filter(({ name }) => name === kind);
      if (these.length < 2) return these.map((one) => link(one, FILES[kind]));
      return html`<details><summary class="button"><${Icon} name="save" />${FILES[kind]}, ${these.length} files</summary><div class="many">${kind === "program" && html`<a class="button" href=${address(`${path}/files/programs`)} download><${Icon} name="save" />All in one ZIP</a>`}${these.map((one) => link(one, one.file))}</div></details>`;
    })}
  </div>`;
}

/** Download text or bytes as a file. */
export function saveText(text, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "text/plain" }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** A portable file name. */
export function fileName(title) {
  return title.normalize("NFKD").replace(/[^A-Za-z0-9]+/g, "-").replace(/^-+|-+$/g, "").toLowerCase() || "job";
}
