/* Comparison of strategies: a table, and the Pareto front of time and error. */

import { Fragment, html, render, useState } from "./vendor/preact.js";
import { takeJob } from "./form.js";
import { start } from "./runs.js";
import { say, state } from "./state.js";
import { Downloads, Icon, Mark, bytes, count, duration, height, number, percent, useStore } from "./ui.js";

const ERRORS = { pv_nm: "PV", rms_nm: "RMS", sq_nm: "Sq" };

const COLUMNS = [
  { key: "name", title: "strategy", value: ({ name }) => name, show: ({ name, limits, turns, size_bytes: size }) => html`${name}<small class="block">${count(limits.points)} points, ${number(turns, 4)} revolutions, ${bytes(size)}</small>` },
  { key: "time", title: "time", value: ({ limits }) => limits.cycle_time_s, show: ({ limits }) => html`${duration(limits.cycle_time_s)}<small class="block">${limits.binding ?? "no limit"}</small>` },
  ...[["pv_nm", "PV", "peak to valley of cut minus nominal surface"], ["rms_nm", "RMS", "of cut minus nominal surface"], ["sq_nm", "Sq", "finish: of annuli a few feeds wide"],
    ["cusp_nm", "cusps", "error of an exact path"], ["chord_nm", "chords", "interpolation error between the points of the program"], ["tracking_nm", "servos", "servo contribution; unknown if the machine file does not state the servo response"]]
    .map(([key, title, meaning]) => ({ key, title, meaning, value: ({ breakdown }) => breakdown[key], show: ({ breakdown }) => height(key === "tracking_nm" && breakdown[key] === 0 ? Number.NaN : breakdown[key]) })),
];

/** Load a strategy into the form as one undo step. */
function takeStrategy(comparison, { name, strategy }) {
  const job = structuredClone(state.job);
  job.strategy = strategy;
  // Settings of the last pass and of a fast tool servo table belong to the previous strategy.
  for (const key of ["feed", "points_per_rev", "arc_length", "max_step", "chord", "scallop"]) delete job.passes?.at(-1)[key];
  const { fast_tool: _, fast_tool_rate: __, ...program } = job.program ?? {};
  if (!/^(fast|hybrid)/.test(strategy.kind) && strategy.x_motion !== "split" && job.program) job.program = program;
  takeJob({ job, fresh: false });
  say(`Strategy of the job: ${name}. Press Ctrl+Z to undo.`);
}

/** The Pareto front: candidates for which no other is both faster and more accurate. */
function unbeaten(candidates, error) {
  const at = (one) => [one.limits.cycle_time_s, one.breakdown[error]];
  return new Set(candidates.filter((one) => {
    const [time, size] = at(one);
    return !candidates.some((other) => {
      const [otherTime, otherSize] = at(other);
      return otherTime <= time && otherSize <= size && (otherTime < time || otherSize < size);
    });
  }));
}

/** Tick labels of times, with enough digits to be distinct. */
function timeText(value, marks) {
  const step = marks.length > 1 ? marks[1] - marks[0] : value;
  return step >= 1 && !(value >= 3600 && step < 60) ? duration(value) : `${number(value, 1 + Math.max(0, Math.floor(Math.log10(value)) - Math.floor(Math.log10(step))))}\u202fs`;
}

function ticks(low, high, log) {
  if (!log) {
    const step = 10 ** Math.floor(Math.log10((high - low) / 3));
    const wide = [1, 2, 5, 10].map((one) => one * step).find((one) => (high - low) / one <= 5);
    const first = Math.ceil(low / wide);
    return Array.from({ length: Math.floor(high / wide) - first + 1 }, (_, index) => (first + index) * wide);
  }
  const all = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power += 1) {
    for (const one of high / low > 50 ? [1] : [1, 2, 5]) all.push(one * 10 ** power);
  }
  return all.filter((one) => one >= low && one <= high);
}

function scale(values, from, to) {
  const [least, most] = [Math.min(...values), Math.max(...values)];
  const log = least > 0 && most / least > 8;
  const [low, high] = log ? [least / 1.4, most * 1.4] : [Math.max(0, least - 0.15 * (most - least || least)), most + 0.15 * (most - least || most)];
  const f = log ? Math.log : (value) => value;
  return { at: (value) => from + ((f(value) - f(low)) / (f(high) - f(low) || 1)) * (to - from), ticks: ticks(low, high, log) };
}

function Pareto({ candidates, error, chosen, choose, best }) {
  const [wide, tall, left, foot] = [360, 226, 62, 38];
  const x = scale(candidates.map(({ limits }) => limits.cycle_time_s), left, wide - 14);
  const y = scale(candidates.map(({ breakdown }) => breakdown[error]), tall - foot, 12);
  const front = [...best].sort((a, b) => a.limits.cycle_time_s - b.limits.cycle_time_s);
  const steps = front.map((one, index) => {
    const [px, py] = [x.at(one.limits.cycle_time_s), y.at(one.breakdown[error])];
    return index ? `H${px}V${py}` : `M${px} 12V${py}`;
  }).join("");
  return html`<svg class="pareto" viewBox=${`0 0 ${wide} ${tall}`} role="img" aria-label=${`Cycle time against ${ERRORS[error]} error of ${candidates.length} strategies; ${front.map(({ name }) => name).join(", ")} ${front.length === 1 ? "is" : "are"} on the Pareto front`}>
    ${x.ticks.map((value) => html`<g class="tick"><line x1=${x.at(value)} x2=${x.at(value)} y1="12" y2=${tall - foot} /><text x=${x.at(value)} y=${tall - foot + 14} text-anchor="middle">${timeText(value, x.ticks)}</text></g>`)}
    ${y.ticks.map((value) => html`<g class="tick"><line x1=${left} x2=${wide - 14} y1=${y.at(value)} y2=${y.at(value)} /><text x=${left - 6} y=${y.at(value) + 4} text-anchor="end">${height(value, 2)}</text></g>`)}
    <text class="axis" x=${(left + wide) / 2} y=${tall - 6} text-anchor="middle">cutting time</text>
    <text class="axis" transform=${`translate(12 ${(tall - foot) / 2 + 6}) rotate(-90)`} text-anchor="middle">${ERRORS[error]} error</text>
    ${front.length > 0 && html`<path class="front" d=${`${steps}H${wide - 14}`} />`}
    ${candidates.map((one) => html`<g class=${`spot${best.has(one) ? " best" : ""}${one.name === chosen ? " chosen" : ""}`} onPointerEnter=${() => choose(one.name)}>
      <circle cx=${x.at(one.limits.cycle_time_s)} cy=${y.at(one.breakdown[error])} r=${one.name === chosen ? 7 : 5} /><title>${one.name}</title></g>`)}
  </svg>`;
}

function Panel() {
  const { comparison, runs, run, job, errors } = useStore(["comparison", "runs", "run", "job", "errors"]);
  const [sort, order] = useState({ key: "time", down: false });
  const [error, judge] = useState("pv_nm");
  const [chosen, choose] = useState(null);
  if (!comparison) {
    const going = runs.find((one) => one.id === run && one.kind === "compare" && ["queued", "running"].includes(one.state));
    return html`<div class="teach"><h3>${going ? "Comparing …" : "Which strategy?"}</h3>
      <p>A comparison plans the finishing pass with every strategy of the machine, all for the same cusp and chord errors. It lists form error, cutting time and the limiting quantity of each.</p>
      ${going ? html`<p role="status">${going.progress ? `${going.progress.stage}, ${percent(going.progress.fraction)}` : "starting"}</p>`
        : html`<p><button type="button" class="button accent" disabled=${!job || errors.length > 0} onClick=${() => start("compare")}>Compare the strategies</button></p>${!job && html`<p>Open a job or an example first.</p>`}`}</div>`;
  }
  const planned = comparison.candidates.filter(({ refused, limits, breakdown }) => !refused && limits && breakdown);
  const refused = comparison.candidates.filter((one) => !planned.includes(one));
  const best = unbeaten(planned, error);
  const column = COLUMNS.find(({ key }) => key === sort.key);
  const rows = [...planned].sort((a, b) => {
    const [one, other] = [column.value(a), column.value(b)];
    return (typeof one === "string" ? one.localeCompare(other) : one - other) * (sort.down ? -1 : 1);
  });
  const part = comparison.data?.part?.name;
  return html`<div class="split compare">
    <div class="scroll" role="region" tabindex="0" aria-label="Strategies compared">
      <table class="data"><caption>${part ? `${part}: all` : "All"} to cusps of ${height(comparison.scallop * 1e6)} and chords of ${height(comparison.chord * 1e6)}</caption>
        <thead><tr>${COLUMNS.map(({ key, title, meaning }) => html`<th class=${key === "name" ? "" : "number"} title=${meaning} aria-sort=${sort.key === key ? (sort.down ? "descending" : "ascending") : "none"}>
          <button type="button" class="link" onClick=${() => order({ key, down: sort.key === key && !sort.down })}>${title}${sort.key === key ? (sort.down ? " ↓" : " ↑") : ""}</button></th>`)}<th><span class="sr">Use</span></th></tr></thead>
        <tbody>${rows.map((one) => html`<tr key=${one.name} class=${one.name === chosen ? "chosen" : ""} onPointerEnter=${() => choose(one.name)} onFocusIn=${() => choose(one.name)}>
          ${COLUMNS.map(({ key, show }) => (key === "name"
            ? html`<th scope="row"><span class="spotmark" title=${best.has(one) ? "on the Pareto front of time and error" : ""}>${best.has(one) && html`<${Mark} ok />`}</span><span>${show(one)}</span></th>`
            : html`<td class="number">${show(one)}</td>`))}
          <td>${one.strategy?.kind && html`<button type="button" class="button take" disabled=${!job} title="Use this strategy in the job; Ctrl+Z undoes it" onClick=${() => takeStrategy(comparison, one)}><${Icon} name="left" />Take</button>`}</td></tr>`)}</tbody></table>
      ${refused.length > 0 && html`<${Fragment}><h4>Not possible</h4><ul class="sentences">${refused.map((one) => html`<li><strong>${one.name}</strong> ${one.refused}</li>`)}</ul></${Fragment}>`}
      <${Downloads} path=${`/runs/${comparison.run}`} files=${comparison.files} />
    </div>
    <figure><figcaption>Time against <select aria-label="Error to compare" onChange=${(event) => judge(event.target.value)}>${Object.entries(ERRORS).map(([key, title]) => html`<option value=${key} selected=${key === error}>${title}</option>`)}</select> <span class="quiet">Lower left is better; the line is the Pareto front.</span></figcaption>
      <${Pareto} candidates=${planned} error=${error} chosen=${chosen} choose=${choose} best=${best} /></figure>
  </div>`;
}

export function mount(element) {
  render(html`<${Panel} />`, element);
  return { destroy: () => render(null, element) };
}
