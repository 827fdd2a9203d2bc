/* The strategies side by side: a table, and which of them no other beats in both time and error. */

import { Fragment, html, render, useState } from "./vendor/preact.js";
import { start } from "./runs.js";
import { Downloads, Mark, bytes, count, duration, height, number, useStore } from "./ui.js";

const ERRORS = { pv_nm: "PV", rms_nm: "RMS", sq_nm: "Sq" };

const COLUMNS = [
  { key: "name", title: "strategy", value: ({ name }) => name, show: ({ name }) => name },
  { key: "time", title: "time", value: ({ limits }) => limits.cycle_time_s, show: ({ limits }) => duration(limits.cycle_time_s) },
  { key: "binding", title: "limited by", value: ({ limits }) => limits.binding ?? "", show: ({ limits }) => limits.binding ?? "nothing" },
  { key: "pv_nm", title: "PV", value: ({ shares }) => shares.pv_nm, show: ({ shares }) => height(shares.pv_nm) },
  { key: "rms_nm", title: "RMS", value: ({ shares }) => shares.rms_nm, show: ({ shares }) => height(shares.rms_nm) },
  { key: "sq_nm", title: "Sq", value: ({ shares }) => shares.sq_nm, show: ({ shares }) => height(shares.sq_nm) },
  { key: "points", title: "points", value: ({ limits }) => limits.points, show: ({ limits }) => count(limits.points) },
  { key: "turns", title: "turns", value: ({ turns }) => turns, show: ({ turns }) => number(turns, 4) },
  { key: "size", title: "program", value: ({ size_bytes }) => size_bytes, show: ({ size_bytes }) => bytes(size_bytes) },
  { key: "cusp_nm", title: "cusps", value: ({ shares }) => shares.cusp_nm, show: ({ shares }) => height(shares.cusp_nm) },
  { key: "chord_nm", title: "chords", value: ({ shares }) => shares.chord_nm, show: ({ shares }) => height(shares.chord_nm) },
  { key: "tracking_nm", title: "servos", value: ({ shares }) => shares.tracking_nm, show: ({ shares }) => height(shares.tracking_nm) },
];

/** The candidates that no other beats: none is both as quick and as exact. */
function unbeaten(candidates, error) {
  const at = (one) => [one.limits.cycle_time_s, one.shares[error]];
  return new Set(candidates.filter((one) => {
    const [time, left] = at(one);
    return !candidates.some((other) => {
      const [quicker, better] = at(other);
      return quicker <= time && better <= left && (quicker < time || better < left);
    });
  }));
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
  const [wide, tall, left, foot] = [440, 250, 62, 38];
  const x = scale(candidates.map(({ limits }) => limits.cycle_time_s), left, wide - 14);
  const y = scale(candidates.map(({ shares }) => shares[error]), tall - foot, 12);
  const front = [...best].sort((a, b) => a.limits.cycle_time_s - b.limits.cycle_time_s);
  const steps = front.map((one, index) => {
    const [px, py] = [x.at(one.limits.cycle_time_s), y.at(one.shares[error])];
    return index ? `H${px}V${py}` : `M${px} 12V${py}`;
  }).join("");
  return html`<svg class="pareto" viewBox=${`0 0 ${wide} ${tall}`} role="img" aria-label=${`Cycle time against ${ERRORS[error]} error of ${candidates.length} strategies; ${front.map(({ name }) => name).join(", ")} ${front.length === 1 ? "is" : "are"} not beaten`}>
    ${x.ticks.map((value) => html`<g class="tick"><line x1=${x.at(value)} x2=${x.at(value)} y1="12" y2=${tall - foot} /><text x=${x.at(value)} y=${tall - foot + 14} text-anchor="middle">${duration(value)}</text></g>`)}
    ${y.ticks.map((value) => html`<g class="tick"><line x1=${left} x2=${wide - 14} y1=${y.at(value)} y2=${y.at(value)} /><text x=${left - 6} y=${y.at(value) + 4} text-anchor="end">${height(value, 2)}</text></g>`)}
    <text class="axis" x=${(left + wide) / 2} y=${tall - 6} text-anchor="middle">cutting time</text>
    <text class="axis" transform=${`translate(12 ${(tall - foot) / 2 + 6}) rotate(-90)`} text-anchor="middle">${ERRORS[error]} error</text>
    ${front.length > 0 && html`<path class="front" d=${`${steps}H${wide - 14}`} />`}
    ${candidates.map((one) => html`<g class=${`spot${best.has(one) ? " best" : ""}${one.name === chosen ? " chosen" : ""}`} onPointerEnter=${() => choose(one.name)}>
      <circle cx=${x.at(one.limits.cycle_time_s)} cy=${y.at(one.shares[error])} r=${one.name === chosen ? 7 : 5} /><title>${one.name}</title></g>`)}
  </svg>`;
}

function Panel() {
  const { comparison, runs, run, job, files } = useStore(["comparison", "runs", "run", "job", "files"]);
  const [sort, order] = useState({ key: "time", down: false });
  const [error, judge] = useState("pv_nm");
  const [chosen, choose] = useState(null);
  const kept = runs.find((one) => one.id === run && one.kind === "compare");
  if (!comparison) {
    const busy = kept && ["queued", "running"].includes(kept.state);
    return html`<div class="teach"><h3>${busy ? "Comparing …" : "Which strategy?"}</h3>
      <p>A comparison plans the finishing pass by every strategy that the machine can do, all to the same cusp and chord errors, and says what each leaves, how long it takes and what limits it.</p>
      <p><button type="button" class="button accent" disabled=${!job || busy} onClick=${() => start("compare")}>Compare the strategies</button></p></div>`;
  }
  const planned = comparison.candidates.filter(({ refused, limits, shares }) => !refused && limits && shares);
  const refused = comparison.candidates.filter((one) => !planned.includes(one));
  const best = unbeaten(planned, error);
  const column = COLUMNS.find(({ key }) => key === sort.key);
  const rows = [...planned].sort((a, b) => {
    const [one, other] = [column.value(a), column.value(b)];
    return (typeof one === "string" ? one.localeCompare(other) : one - other) * (sort.down ? -1 : 1);
  });
  return html`<div class="split compare">
    <div class="scroll">
      <table class="data"><caption>All to cusps of ${height(comparison.scallop * 1e6)} and chords of ${height(comparison.chord * 1e6)}</caption>
        <thead><tr><th></th>${COLUMNS.map(({ key, title }) => html`<th class=${["name", "binding"].includes(key) ? "" : "number"} aria-sort=${sort.key === key ? (sort.down ? "descending" : "ascending") : "none"}>
          <button type="button" class="link" onClick=${() => order({ key, down: sort.key === key && !sort.down })}>${title}${sort.key === key ? (sort.down ? " ↓" : " ↑") : ""}</button></th>`)}</tr></thead>
        <tbody>${rows.map((one) => html`<tr class=${one.name === chosen ? "chosen" : ""} onPointerEnter=${() => choose(one.name)}>
          <td title=${best.has(one) ? "no other is both as quick and as exact" : ""}>${best.has(one) && html`<${Mark} ok />`}</td>
          ${COLUMNS.map(({ key, show }) => (key === "name" ? html`<th scope="row">${show(one)}</th>` : html`<td class=${key === "binding" ? "" : "number"}>${show(one)}</td>`))}</tr>`)}</tbody></table>
      ${refused.length > 0 && html`<${Fragment}><h4>Cannot be done</h4><ul class="sentences">${refused.map((one) => html`<li><strong>${one.name}</strong> ${one.refused}</li>`)}</ul></${Fragment}>`}
      ${kept && html`<${Downloads} path=${`/runs/${kept.id}`} files=${files} />`}
    </div>
    <figure><figcaption>Time against <select aria-label="Error to judge by" onChange=${(event) => judge(event.target.value)}>${Object.entries(ERRORS).map(([key, title]) => html`<option value=${key} selected=${key === error}>${title}</option>`)}</select>: <span class="quiet">left and low is good; those on the line no other beats in both</span></figcaption>
      <${Pareto} candidates=${planned} error=${error} chosen=${chosen} choose=${choose} best=${best} /></figure>
  </div>`;
}

export function mount(element) {
  render(html`<${Panel} />`, element);
  return { destroy: () => render(null, element) };
}
