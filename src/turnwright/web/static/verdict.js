/* The results pane: check of the current job, and results of the selected run. */

import { Fragment, html, render, useEffect, useState } from "./vendor/preact.js";
import { get } from "./api.js";
import { on, set } from "./state.js";
import { Bar, Downloads, Gauge, Icon, Mark, bytes, count, duration, height, length, number, percent, quantity, useStore } from "./ui.js";
import { Queue, editAgain } from "./runs.js";

function Card({ title, side = null, children }) {
  return html`<section class="card"><header><h3>${title}</h3><span class="gap"></span>${side}</header>${children}</section>`;
}

function Figure({ label, children, note = "" }) {
  return html`<div class="figure"><dt>${label}</dt><dd>${children}${note && html`<small>${note}</small>`}</dd></div>`;
}

const point = (where) => set({ cursor: where });

// ---------------------------------------------------------------------------------------------------------- the plan

const UNITS = { "nose radius": "mm", "included angle": "rad", clearance: "rad", rake: "rad" };

function Finding({ finding }) {
  const unit = UNITS[finding.name];
  const share = finding.limit ? finding.value / finding.limit : Number.NaN;
  return html`<li class=${finding.ok ? "finding" : "finding bad"}>
    <div class="line"><${Mark} ok=${finding.ok} /><strong>${finding.name}</strong><span class="gap"></span>
      ${finding.limit !== null && unit && html`<span class="number">${quantity(finding.value, unit)} <span class="quiet">of ${quantity(finding.limit, unit)}</span></span>`}
      ${finding.where && html`<button type="button" class="tool" title="Show where" aria-label=${`Show where the ${finding.name} is critical`} onClick=${() => point(finding.where)}><${Icon} name="place" /></button>`}
    </div>
    ${Number.isFinite(share) && html`<${Gauge} share=${share} bad=${!finding.ok} label=${`${finding.name}: utilisation of its limit`} />`}
    <p class=${finding.ok ? "quiet" : ""}>${finding.sentence}</p>
  </li>`;
}

function Plan() {
  const { job, check, errors, checking } = useStore(["job", "check", "errors", "checking"]);
  if (!job) return html`<p class="quiet pad">The check of the job is shown here: tool access, length of the program, and limits.</p>`;
  if (!check) return html`<p class="quiet pad">${errors.length ? "Correct the marked fields first." : checking ? "Checking the job …" : "The job could not be checked; see the message at the bottom of the page."}</p>`;
  const { access, preview, chips = {}, warnings = [] } = check;
  // Tool access is checked even if the path cannot be planned.
  const stale = errors.length > 0 && check.errors !== errors;
  const refused = preview?.refused ?? [];
  const ok = access.ok && refused.length === 0 && !(errors.length > 0 && !stale);
  return html`<${Fragment}>${errors.length > 0 && html`<section class="card bad"><header><h3>${stale ? "The job has errors" : "The path cannot be planned"}</h3></header>
      <ul class="sentences">${errors.slice(0, 4).map((error) => html`<li>${error.sentence}</li>`)}</ul>${stale && html`<p class="quiet">Below: the last valid job.</p>`}</section>`}
    <div class=${stale ? "cards stale" : "cards"} aria-busy=${checking ? "true" : "false"}>
    <section class=${ok ? "card verdict good" : "card verdict bad"} id="verdict" aria-live="polite">
      <${Mark} ok=${ok} /><div><h3>${ok ? "The tool has access to the part" : access.ok ? "A run would stop with an error" : "The tool has no access to the part"}</h3>
      ${refused.map((sentence) => html`<p>${sentence}</p>`)}</div>
    </section>
    <${Card} title="Access"><ul class="findings">${access.findings.map((finding) => html`<${Finding} key=${finding.name} finding=${finding} />`)}</ul></${Card}>
    ${Object.keys(preview?.points ?? {}).length > 0 && html`<${Length} preview=${preview} />`}
    ${Object.keys(preview?.shape ?? {}).length > 0 && html`<${Card} title="Part">
      <dl class="facts">${Object.entries(preview.shape).map(([name, text]) => html`<dt>${name}</dt><dd>${text.replaceAll(" um", " µm")}</dd>`)}</dl>
      ${preview.remarks.map((sentence) => html`<p class="quiet">${sentence}</p>`)}</${Card}>`}
    ${preview?.unjudged.length > 0 && html`<${Card} title="Tolerances"><ul class="sentences">${preview.unjudged.map((sentence) => html`<li>${sentence}</li>`)}</ul></${Card}>`}
    ${Object.keys(chips).length > 0 && html`<${Card} title="Uncut chip thickness"><ul class="sentences">${Object.entries(chips).map(([name, sentence]) => html`<li><strong>${name}</strong> ${String(sentence)}</li>`)}</ul></${Card}>`}
    ${warnings.length > 0 && html`<${Warnings} warnings=${warnings} />`}
    </div></${Fragment}>`;
}

function Length({ preview }) {
  const names = Object.keys(preview.points);
  const points = Object.values(preview.points).reduce((sum, one) => sum + one, 0);
  const seconds = Object.values(preview.shortest_s).reduce((sum, one) => sum + (one ?? Number.NaN), 0);
  const longest = Math.max(...Object.values(preview.shortest_s).map((one) => one ?? 0));
  return html`<${Card} title="Program">
    <dl class="figures">
      <${Figure} label="at least">${duration(seconds)}</${Figure}>
      <${Figure} label="points">${count(points)}</${Figure}>
    </dl>
    ${names.length > 1 && html`<table class="small"><thead><tr><th>pass</th><th class="number">points</th><th class="number">at least</th><th></th></tr></thead>
      <tbody>${names.map((name) => html`<tr><th scope="row">${name}</th><td class="number">${count(preview.points[name])}</td><td class="number">${duration(preview.shortest_s[name])}</td>
        <td class="meter"><${Bar} share=${(preview.shortest_s[name] ?? 0) / longest} /></td></tr>`)}</tbody></table>`}
    <p class="quiet">From block rate and spindle speed only; a run includes the axis limits.</p>
  </${Card}>`;
}

function Warnings({ warnings }) {
  return html`<section class="card warn"><header><${Mark} ok=${false} warn /><h3>${warnings.length === 1 ? "1 warning" : `${warnings.length} warnings`}</h3></header>
    <ul class="sentences">${warnings.map((sentence) => html`<li>${sentence}</li>`)}</ul></section>`;
}

// ----------------------------------------------------------------------------------------------------------- the run

function Outcome() {
  const { result, run, runs, files } = useStore(["result", "run", "runs", "files"]);
  const entry = runs.find((one) => one.id === run);
  if (!entry || !result?.passes) return null;
  const last = result.passes.at(-1);
  const seconds = result.passes.reduce((sum, cut) => sum + cut.limits.cycle_time_s, 0);
  return html`<div class="cards" id="outcome">
    <${Tolerances} result=${result} />
    <${Card} title="Simulated surface">
      <table class="small"><thead><tr><th>map</th><th class="number">PV</th><th class="number">Sq</th><th class="number">Sa</th></tr></thead>
      <tbody>${result.predictions.map(({ name, roughness, pv_nm }) => html`<tr class="pick" onClick=${() => set({ map: name, drawer: "maps", view: "drawer" })}>
        <th scope="row"><button type="button" class="link" onClick=${() => set({ map: name, drawer: "maps", view: "drawer" })}>${name}</button></th>
        <td class="number">${height(pv_nm ?? roughness.pv_nm)}</td><td class="number">${height(roughness.sq_nm)}</td><td class="number">${height(roughness.sa_nm)}</td></tr>`)}</tbody></table>
    </${Card}>
    ${result.warnings.length > 0 && html`<${Warnings} warnings=${result.warnings} />`}
    <${Budget} run=${run} result=${result} />
    <${Card} title="Cycle" side=${html`<span class="quiet">${result.dialect}</span>`}>
      <dl class="figures">
        <${Figure} label="cutting time">${duration(seconds)}</${Figure}>
        <${Figure} label="limited by">${last.limits.binding ?? "no limit"}</${Figure}>
        <${Figure} label="points">${count(result.passes.reduce((sum, cut) => sum + cut.points, 0))}</${Figure}>
        <${Figure} label="spindle">${number(last.spindle_rpm)} rpm</${Figure}>
      </dl>
      <${Limits} limits=${last.limits} name=${last.name} />
    </${Card}>
    <${Chips} passes=${result.passes} />
    ${result.optics && html`<${Optics} light=${result.optics} />`}
    <${Card} title="Program"><p class="quiet">${count(result.program.lines)} lines in ${result.program.files.length === 1 ? "one file" : `${result.program.files.length} files`}, ${bytes(result.program.bytes)}; rounding changes the surface by ${height(result.rounding_nm)}, limit ${height(result.rounding_limit_nm)}.</p>
      <${Downloads} path=${`/runs/${run}`} files=${files} />
      <p><button type="button" class="add" onClick=${() => editAgain(run)}><${Icon} name="left" />Edit this job</button></p></${Card}>
  </div>`;
}

/** The verdict on a run: its tolerances first, then the limits of the machine. */
function Tolerances({ result }) {
  const { verdicts = [], ok } = result;
  const missed = verdicts.filter(({ kept }) => kept === false);
  const open = verdicts.filter(({ kept }) => kept === null);
  const head = missed.length ? `Misses ${missed.length === 1 ? "a tolerance" : `${missed.length} tolerances`}`
    : !ok ? "Exceeds a limit"
    : open.length ? "Within all limits, some tolerances not evaluated"
    : verdicts.length ? "Meets all tolerances, within all limits" : "Within all limits; no tolerance is stated";
  const good = ok && !missed.length && !open.length;
  return html`<section class=${good ? "card verdict good" : missed.length || !ok ? "card verdict bad" : "card verdict"}><${Mark} ok=${good} warn=${!missed.length && ok} />
    <div><h3>${head}</h3>${missed.length > 0 && !ok && html`<p>Exceeds a limit as well.</p>`}
      ${[...missed, ...open, ...verdicts.filter(({ kept }) => kept)].map(({ sentence }) => html`<p>${sentence}</p>`)}
      <p class="quiet">${result.part}, on ${result.machine}</p></div></section>`;
}

function Limits({ limits, name }) {
  const used = Object.entries(limits.utilisation).sort(([, a], [, b]) => b - a);
  return html`<${Fragment}><h4>${name}: utilisation of limits</h4>
    <ul class="gauges">${used.slice(0, 6).map(([what, share]) => html`<li><span>${what}</span><${Gauge} share=${share} bad=${share > 1 + 1e-6} label=${what} /><span class="number">${percent(share)}</span></li>`)}</ul>
    ${limits.findings.length > 0 && html`<ul class="sentences">${limits.findings.map((finding) => html`<li>${finding.sentence ?? String(finding)}</li>`)}</ul>`}</${Fragment}>`;
}

const SHARES = [
  ["cusp_away_nm", "cusps", "error of an exact path, away from the axis"],
  ["cusp_nm", "cusps at the axis", "error of an exact path at the axis, where the first or last revolution has one neighbour only"],
  ["chord_nm", "interpolation", "change by the controller's interpolation between points"],
  ["rounding_nm", "decimals", "change by rounding in the program"],
  ["tracking_nm", "servos", "change by the servo response of the axes"],
];

/** Error budget as bars; computing it takes about as long as planning. */
function Budget({ run, result }) {
  const [budget, setBudget] = useState(null);
  useEffect(() => {
    const asking = new AbortController();
    setBudget(null);
    get(`/runs/${run}/budget`, {}, { signal: asking.signal }).then(setBudget, (error) => error.name !== "AbortError" && setBudget({ refused: error.message }));
    return () => asking.abort();
  }, [run, result]);
  const side = html`<span class="quiet">peak to valley</span>`;
  if (!budget) return html`<${Card} title="Error budget" side=${side}><p class="quiet" role="status">Simulating the finishing pass with and without interpolation, rounding and servo response …</p></${Card}>`;
  if (budget.refused) return html`<${Card} title="Error budget" side=${side}><p class="quiet">${budget.refused}</p></${Card}>`;
  const entries = SHARES.filter(([key]) => Number.isFinite(budget[key]) && !(key === "tracking_nm" && !budget.servos) && !(key === "cusp_nm" && budget.cusp_nm < 1.02 * budget.cusp_away_nm))
    .sort(([one], [other]) => budget[other] - budget[one]);
  const most = Math.max(budget.pv_nm ?? 0, ...entries.map(([key]) => budget[key]));
  return html`<${Card} title="Error budget" side=${side}>
    <ul class="gauges named" id="budget">${entries.map(([key, name, meaning]) => html`<li title=${meaning}><span>${name}</span><${Bar} share=${budget[key] / most} /><span class="number">${height(budget[key])}</span></li>`)}
      <li class="sum"><span>total</span><${Bar} share=${budget.pv_nm / most} /><span class="number">${height(budget.pv_nm)}</span></li></ul>
    <p class="quiet">Contributions are simulated separately and do not add up; total RMS ${height(budget.rms_nm)}.${budget.servos ? "" : " The servo contribution is not included: the machine file does not state the servo response."}</p></${Card}>`;
}

/** Uncut chip thickness of each pass, with the ductile-mode check. */
function Chips({ passes }) {
  const known = passes.filter(({ chips }) => chips);
  if (!known.length) return null;
  return html`<${Card} title="Uncut chip thickness" side=${html`<button type="button" class="link quiet" onClick=${() => set({ quantity: "chips" })}>show on the part</button>`}>
    <table class="small"><thead><tr><th></th><th>pass</th><th class="number">maximum</th><th class="number">critical</th></tr></thead>
    <tbody>${known.map(({ name, chips }) => html`<tr title=${chips.sentence}><td><${Mark} ok=${chips.ok} warn=${chips.ok !== true} /></td><th scope="row">${name}<small class="block">${chips.verdict}${Number.isFinite(chips.margin) ? `, margin ${percent(chips.margin)}` : ""}</small></th>
      <td class="number">${length(chips.thickest)}</td><td class="number">${chips.critical ? length(chips.critical) : "–"}</td></tr>`)}</tbody></table></${Card}>`;
}

/** Optical performance, with the modulation along x and y over the spatial frequency. */
function Optics({ light }) {
  const [{ frequency, x, y }, perMm] = [light.mtf, light.frequency_unit === "1/mm"];
  const line = (values) => values.map((value, index) => `${(200 * frequency[index] / frequency.at(-1)).toFixed(1)},${(80 - 78 * value).toFixed(1)}`).join(" ");
  const first = light.orders.find(({ order }) => order === 1);
  return html`<${Card} title="Optical performance" side=${html`<span class="quiet">${quantity(light.wavelength, "mm")}</span>`}>
    <dl class="figures" id="optics">
      <${Figure} label="Strehl ratio" note="form and cusps">${number(light.strehl)}</${Figure}>
      <${Figure} label="of the form">${number(light.form_strehl)}</${Figure}>
      <${Figure} label="wavefront, rms">${number(light.rms_waves)} waves</${Figure}>
      ${first && html`<${Figure} label="first order of the cusps" note=${Number.isFinite(first.angle) ? `at ${(first.angle * 180 / Math.PI).toFixed(2)}°` : "does not propagate"}>${(100 * first.efficiency).toPrecision(3)} %</${Figure}>`}
      ${Object.entries(light.scatter).map(([name, tis]) => html`<${Figure} label=${`scatter, ${name}`}>${(100 * tis).toPrecision(3)} %</${Figure}>`)}
    </dl>
    <svg viewBox="0 0 200 82" role="img" aria-label=${`Modulation from 0 to ${number(frequency.at(-1))} ${light.frequency_unit}, along x and along y`} style="width:100%;height:auto">
      <polyline points="0,80 200,80" fill="none" stroke="var(--edge)" /><polyline points=${line(x)} fill="none" stroke="var(--accent)" /><polyline points=${line(y)} fill="none" stroke="var(--bad)" stroke-dasharray="3 2" /></svg>
    <p class="quiet">Modulation along x and y (dashed), up to ${number(frequency.at(-1))} ${perMm ? "per mm" : "per rad"}.</p></${Card}>`;
}

// ---------------------------------------------------------------------------------------------------------- the pane

function Pane() {
  const [tab, show] = useState("plan");
  const { runs, run } = useStore(["runs", "run"]);
  // Show the runs when one is started or selected.
  useEffect(() => on("run", ({ run: id }) => id && show("runs")), []);
  const busy = runs.filter((one) => one.state === "queued" || one.state === "running").length;
  const head = (name, title) => html`<button type="button" role="tab" aria-selected=${tab === name ? "true" : "false"} tabindex=${tab === name ? 0 : -1} onClick=${() => show(name)}
    onKeyDown=${(event) => ["ArrowLeft", "ArrowRight"].includes(event.key) && show(tab === "plan" ? "runs" : "plan")}>${title}</button>`;
  return html`<${Fragment}>
    <div class="panehead"><div class="tabs" role="tablist" aria-label="Results">
      ${head("plan", "Plan")}${head("runs", busy ? html`Runs <span class="count going">${busy}</span>` : runs.length ? `Runs (${runs.length})` : "Runs")}</div></div>
    <div class="scroll" role="region" tabindex="0" aria-label="Results">${tab === "plan" ? html`<${Plan} />` : html`<${Fragment}><${Queue} />${run && html`<${Outcome} />`}</${Fragment}>`}</div>
  </${Fragment}>`;
}

export function mount(element) {
  render(html`<${Pane} />`, element);
  return { destroy: () => render(null, element) };
}
