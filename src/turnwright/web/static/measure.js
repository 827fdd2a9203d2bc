/* Measured parts: upload, registration, diagnosis and correction. */

import { Fragment, html, render, useEffect, useRef, useState } from "./vendor/preact.js";
import { get, getPacked, post, sendForPacked, upload } from "./api.js";
import { say, set, state } from "./state.js";
import { chart } from "./charts.js";
import { GOING, clear, follow, halt } from "./measurement.js";
import { editAgain, refresh } from "./runs.js";
import { Bar, Downloads, Icon, Mark, Tool, bytes, count, doubted, height, number, percent, quantity, useStore } from "./ui.js";

let sending = () => {};
let showing = () => {};

/** Upload a measured map of the part of the selected run. */
export async function take(file, of = measuredRun()) {
  // A file may be dropped before the list of runs is loaded.
  if (!of) await refresh();
  const run = of ?? measuredRun();
  if (!run) return say("Run the job first: a measurement is compared with the part of a run.", "bad");
  const limit = state.about?.limits.upload_bytes;
  if (limit && file.size > limit) return say(`${file.name} has ${bytes(file.size)}, the limit is ${bytes(limit)}.`, "bad");
  clear();
  sending({ name: file.name, share: 0 });
  try {
    const { id } = await upload("/measurements", { run, name: file.name }, file, (sent, total) => sending({ name: file.name, share: sent / total }));
    await Promise.all([follow(id), refresh()]);
  } catch (error) {
    say(error.message, "bad");
  } finally {
    sending(null);
  }
}

/** Show a measured map without a job; it is not stored. */
async function look(file) {
  sending({ name: file.name, share: 1 });
  try {
    showing(await sendForPacked("/measurements/show", { name: file.name }, file));
  } catch (error) {
    say(error.message, "bad");
  } finally {
    sending(null);
  }
}

function measuredRun() {
  const fit = (run) => run.state === "done" && ["run", "correct"].includes(run.kind);
  const looked = state.runs.find((run) => run.id === state.run && fit(run));
  return (looked ?? state.runs.find(fit))?.id ?? null;
}

// ------------------------------------------------------------------------------------------------------ bringing it in

function Drop({ sent, types }) {
  const [over, setOver] = useState(false);
  const { runs } = useStore(["runs", "run"]);
  const input = useRef(null);
  const alone = useRef(null);
  const fit = runs.filter((run) => run.state === "done" && ["run", "correct"].includes(run.kind));
  const [chosen, choose] = useState(null);
  const run = chosen ?? measuredRun();
  if (sent) return html`<div class="drop"><h3>${sent.name}</h3><${Bar} share=${sent.share} kind="going" /><p>${sent.share < 1 ? `uploading, ${percent(sent.share)}` : "reading"}</p></div>`;
  return html`<div class=${over ? "drop over" : "drop"} onDragOver=${() => setOver(true)} onDragLeave=${() => setOver(false)} onDrop=${() => setOver(false)}>
    <h3>Measured map</h3>
    <p>Drop a measured map here. It is registered to the part, outliers are removed, and the form error is attributed to tool, machine and mount, each with its uncertainty. The job can then be corrected.</p>
    ${fit.length > 0
      ? html`<p><label>Part of <select aria-label="The run that cut the part" onChange=${(event) => choose(event.target.value)}>${fit.map((one) => html`<option value=${one.id} selected=${one.id === run}>${one.name}</option>`)}</select></label></p>
        <p><button type="button" class="button accent" onClick=${() => input.current.click()}><${Icon} name="open" />Choose a file</button>
        <input type="file" hidden ref=${input} accept=${(types ?? []).join(",")} onChange=${(event) => event.target.files[0] && take(event.target.files[0], run)} /></p>`
      : html`<p><strong>Run the job first:</strong> a measurement is compared with the part of a run.</p>`}
    <p><button type="button" class="button" onClick=${() => alone.current.click()}>Show a map without a job</button>
      <input type="file" hidden ref=${alone} accept=${(types ?? []).join(",")} onChange=${(event) => event.target.files[0] && look(event.target.files[0])} /></p>
    ${types && html`<p><small>${types.join(" ")}</small></p>`}
  </div>`;
}

// ------------------------------------------------------------------------------------------------------- what was seen

function Numbers({ title, rows }) {
  const given = rows.filter(([, value]) => value !== undefined && value !== null && value !== "");
  if (!given.length) return null;
  return html`<section class="card"><header><h3>${title}</h3></header><dl class="pairs">${given.map(([name, value]) => html`<dt>${name}</dt><dd class="number">${value}</dd>`)}</dl></section>`;
}

const POSE_TOL = 1e-6; // mm or rad: a smaller value of a fixed degree of freedom is rounding

const PLACES = [["x", "mm"], ["y", "mm"], ["z", "mm"], ["rotation", "rad"], ["tilt_x", "rad"], ["tilt_y", "rad"]];

/** The degrees of freedom of the part pose with standard uncertainty, or marked as fixed. */
function placed({ pose, std, held }) {
  const values = { x: pose.shift[0], y: pose.shift[1], z: pose.shift[2], rotation: pose.rotation, tilt_x: pose.tilt[0], tilt_y: pose.tilt[1] };
  return PLACES.map(([name, unit]) => [name.replace("_", " "), held.includes(name) ? (Math.abs(values[name]) < POSE_TOL ? "fixed" : html`fixed at ${quantity(values[name], unit)}`) : doubted(values[name], std[name], unit)]);
}

function Seen({ measurement }) {
  const { alignment, roughness } = measurement;
  return html`<div><div class="panehead"><strong>${measurement.name}</strong><span class="gap"></span><${Tool} icon="close" name="Upload another measurement" onClick=${clear} /></div>
  <div class="scroll" role="region" tabindex="0" aria-label="Results of the measurement"><div class="cards">
    <${Numbers} title="Form error" rows=${[
      ["form, PV", height(measurement.form_pv_nm)], ["form, RMS", height(measurement.form_rms_nm)],
      ["after registration, RMS", height(measurement.measured_rms_nm)], ["attributed, RMS", height(measurement.explained_rms_nm)], ["residual, RMS", height(measurement.unexplained_rms_nm)],
      ["roughness Sq", roughness && height(roughness.sq_nm)], ["roughness Sa", roughness && height(roughness.sa_nm)],
      ["outliers removed", count(measurement.outliers)],
    ]} />
    ${alignment && html`<${Numbers} title="Part pose" rows=${[...placed(alignment), ["points", count(alignment.count)], ["residual of the fit, RMS", height(alignment.rms_nm)]]} />`}
    ${alignment?.sentences.length > 1 && html`<section class="card"><ul class="sentences quiet">${alignment.sentences.slice(1).map((sentence) => html`<li>${sentence}</li>`)}</ul></section>`}
    ${measurement.zernike.length > 0 && html`<section class="card"><header><h3>Zernike terms</h3><span class="gap"></span><span class="quiet">fringe, without pose</span></header><${Zernike} terms=${measurement.zernike} /></section>`}
    ${measurement.psd && html`<section class="card"><header><h3>Power spectral density</h3></header><${Spectrum} psd=${measurement.psd} /></section>`}
  </div></div></div>`;
}

/** Terms as bars about zero, without piston, tilt and power, which depend on mount and radius. */
function Zernike({ terms }) {
  const drawn = terms.filter(({ index }) => index > 4);
  const most = Math.max(...drawn.map(({ coefficient_nm }) => Math.abs(coefficient_nm)), 1e-9);
  const [wide, tall, foot] = [264, 110, 16];
  const each = wide / drawn.length;
  const zero = (tall - foot) / 2;
  return html`<svg class="bars" viewBox=${`0 0 ${wide} ${tall}`} role="img" aria-label=${`Fringe Zernike terms; the largest is ${drawn.length ? drawn.reduce((a, b) => (Math.abs(b.coefficient_nm) > Math.abs(a.coefficient_nm) ? b : a)).index : "none"}`}>
    ${drawn.map(({ index, coefficient_nm: nm, uncertainty_nm: doubt }, at) => {
      const size = (Math.abs(nm) / most) * (zero - 10);
      return html`<g><title>${`${index}: ${height(nm)} ± ${height(doubt, 2)}`}</title><rect x=${at * each + 0.8} width=${each - 1.6} y=${nm < 0 ? zero : zero - size} height=${size} />
        ${(index % 5 === 0 || index === 4) && html`<text x=${(at + 0.5) * each} y=${tall - 4} text-anchor="middle">${index}</text>`}</g>`;
    })}
    <line class="zero" x1="0" x2=${wide} y1=${zero} y2=${zero} />
    <text x="0" y="9">±${height(most)}</text>
  </svg>`;
}

function Spectrum({ psd }) {
  const box = useRef(null);
  useEffect(() => {
    const good = psd.frequency.map((one, index) => [one, psd.density[index]]).filter(([frequency, density]) => frequency > 0 && density > 0);
    const drawn = chart(box.current, {
      label: "Power spectral density over spatial frequency",
      x: { label: "frequency", unit: psd.frequency_unit, values: good.map(([frequency]) => frequency) },
      series: [{ label: "density", unit: psd.unit, values: good.map(([, density]) => density) }],
      logX: true,
      logY: true,
    });
    return () => {
      drawn.destroy();
      box.current?.replaceChildren();
    };
  }, [psd]);
  return html`<div class="psd" ref=${box}></div>`;
}

// ----------------------------------------------------------------------------------------------------------- the maps

const MAPS = [
  ["measured", "Measured", "measured − nominal"],
  ["residual", "Residual", "residual after diagnosis"],
  ["predicted", "After correction", "predicted − nominal"],
];

function Map_({ measurement }) {
  const ready = Boolean(measurement.predicted);
  const [name, show] = useState("measured");
  const box = useRef(null);
  useEffect(() => {
    let view = null;
    let gone = false;
    import("./mapview.js").then(({ MapView }) => {
      if (gone) return;
      view = new MapView(box.current, {
        load: (window, signal) => getPacked(`/measurements/${measurement.id}/map`, { name }, { signal }),
        finer: false,
        label: MAPS.find(([key]) => key === name)[2],
        calls: { pointed: (cursor) => set({ cursor }) },
      });
      view.open();
    });
    return () => {
      gone = true;
      view?.destroy();
    };
  }, [measurement.id, name]);
  return html`<div>
    <div class="panehead"><div class="tabs" role="tablist" aria-label="Map">${MAPS.map(([key, title]) => html`<button type="button" role="tab" aria-selected=${key === name ? "true" : "false"} disabled=${key === "predicted" && !ready} onClick=${() => show(key)}>${title}</button>`)}</div></div>
    <div class="map" ref=${box}></div>
  </div>`;
}

/** A measured map without a job: facts and picture. */
function Lone({ packed }) {
  const { header } = packed;
  const box = useRef(null);
  useEffect(() => {
    let view = null;
    let gone = false;
    import("./mapview.js").then(({ MapView }) => {
      if (gone) return;
      view = new MapView(box.current, { load: async () => packed, finer: false, label: "height, plane removed", calls: { pointed: (cursor) => set({ cursor }) } });
      view.open();
    });
    return () => {
      gone = true;
      view?.destroy();
    };
  }, [packed]);
  return html`<div class="measure" id="lone"><div><div class="panehead"><strong>${header.name}</strong><span class="gap"></span><${Tool} icon="close" name="Show another map" onClick=${() => showing(null)} /></div>
    <div class="scroll" role="region" tabindex="0" aria-label="Properties of the file"><div class="cards"><${Numbers} title="The map" rows=${header.rows} /></div></div></div>
    <div><div class="panehead"><strong>Plane removed</strong></div><div class="map" ref=${box}></div></div>
  </div>`;
}

// ------------------------------------------------------------------------------------------------------- the findings

function Findings({ measurement }) {
  const { findings, contributions, lenslets, predicted, correction } = measurement;
  const [chosen, choose] = useState(() => new Set(findings.filter((one) => one.chosen).map((one) => one.error_source)));
  const [all, showAll] = useState(false);
  const { runs } = useStore(["runs"]);
  const run = runs.find((one) => one.id === correction);
  const [files, setFiles] = useState([]);
  useEffect(() => {
    // The prediction is available when the correction is done.
    if (run?.state !== "done") return;
    if (!predicted) follow(measurement.id);
    get(`/runs/${run.id}`).then((detail) => setFiles(detail.files), (error) => say(error.message, "bad"));
  }, [run?.state]);
  const flip = (source) => {
    const next = new Set(chosen);
    if (!next.delete(source)) next.add(source);
    choose(next);
  };
  const [asking, setAsking] = useState(false);
  const correct = async () => {
    setAsking(true);
    try {
      await post(`/measurements/${measurement.id}/correct`, { error_sources: [...chosen] });
      setFiles([]);
      await refresh();
      await follow(measurement.id);
    } catch (error) {
      say(error.message, "bad");
    } finally {
      setAsking(false);
    }
  };
  const going = run && GOING.has(run.state);
  const called = findings.filter((one) => one.correctable || one.rms_nm > 0.1 * measurement.measured_rms_nm);
  return html`<div>
    <div class="panehead"><strong>Error sources</strong><span class="gap"></span>${findings.length > called.length && html`<label class="flag"><input type="checkbox" checked=${all} onChange=${(event) => showAll(event.target.checked)} />all sources</label>`}</div>
    <div class="scroll pad">
      ${!called.length && html`<p class="quiet">No error source is significant; the residual that is significant is compensated as form.</p>`}
      ${called.length > 0 && html`<p class="quiet" id="doubts">±: 95 % interval, whatever the other sources, spindle error motion, drift and form.</p>`}
      ${(all ? findings : called).map((one) => html`<div class="error-source" key=${one.name}>
        <input type="checkbox" id=${`source-${one.name}`} checked=${chosen.has(one.error_source)} disabled=${!one.correctable} onChange=${() => flip(one.error_source)} aria-describedby=${`why-${one.name}`} title="Correct this" />
        <label for=${`source-${one.name}`}>${one.name}</label>
        <span class="number">${doubted(one.value, one.uncertainty, one.unit)}</span>
        <p id=${`why-${one.name}`}>${one.sentence}</p></div>`)}
      ${contributions.filter((one) => all || one.rms_nm > 0.1 * measurement.measured_rms_nm).map((one) => html`<p class="quiet" key=${one.name}>${one.explanation}</p>`)}
      ${lenslets.length > 0 && html`<${Lenslets} lenslets=${lenslets} />`}
      <div class="decide">
        <div class="bar"><button type="button" class="button accent" id="correct" disabled=${going || asking} onClick=${correct}>${chosen.size ? `Correct ${chosen.size > 1 ? `these ${chosen.size}` : "this"} and the form` : "Correct the form"}</button>
        ${going && html`<span class="quiet" role="status">${run.progress ? `${run.progress.stage}, ${percent(run.progress.fraction)}` : "waiting"}</span>`}
        ${predicted && run?.state === "done" && html`<${Predicted} predicted=${predicted} measured=${measurement.form_rms_nm} />`}</div>
        ${run?.state === "done" && html`<${Fragment}><${Downloads} path=${`/runs/${run.id}`} files=${files} only=${["job", "program", "table", "report", "correction"]} />
          <button type="button" class="add" onClick=${() => editAgain(run.id)}><${Icon} name="left" />Edit the corrected job</button></${Fragment}>`}
        ${run?.state === "failed" && html`<p class="wrong">${run.sentence}</p>`}
      </div>
    </div>
  </div>`;
}

/** Predicted residual of a correction; it is marked good if it meets all tolerances and is below the measured error. */
function Predicted({ predicted, measured }) {
  const name = predicted.predicted ? "predicted" : "simulated";
  const { pv_nm, rms_nm } = predicted[name];
  const { missed, sentences = [] } = predicted;
  const better = rms_nm < measured;
  return html`<span><${Mark} ok=${better && !missed.length} warn /> then ${name}: PV ${height(pv_nm)}, RMS ${height(rms_nm)}${better ? "" : `, not below the measured ${height(measured)}`}${missed.map((sentence) => html`<p class="wrong">${sentence}</p>`)}${sentences.map((sentence) => html`<p class="quiet">${sentence}</p>`)}</span>`;
}

/** Dislocations of lenslets: a table, and scaled arrows. */
function Lenslets({ lenslets }) {
  const seen = lenslets.filter((one) => one.centre.every(Number.isFinite)).map((one) => ({ ...one, off: one.centre.map((value, axis) => value - one.design[axis]) }));
  const reach = Math.max(...lenslets.map(({ design }) => Math.max(...design.map(Math.abs))), 1e-9) * 1.4;
  const most = Math.max(...seen.map(({ off }) => Math.hypot(...off)), 1e-12);
  const scale = (0.3 * reach) / most;
  const arrow = ({ design: [x, y], off: [dx, dy] }) => {
    const [ex, ey] = [x + dx * scale, y + dy * scale];
    const angle = Math.atan2(dy, dx);
    const head = 0.04 * reach;
    const wing = (turn) => `${ex - head * Math.cos(angle + turn)},${-(ey - head * Math.sin(angle + turn))}`;
    return `M${x},${-y}L${ex},${-ey}M${wing(0.5)}L${ex},${-ey}L${wing(-0.5)}`;
  };
  return html`<section class="lenses"><h3>Lenses</h3>
    ${seen.length > 0 && html`<svg class="quiver" viewBox=${`${-reach} ${-reach} ${2 * reach} ${2 * reach}`} role="img" aria-label=${`Dislocation of ${seen.length} lenses, at most ${quantity(most, "mm")}`}>
      ${seen.map((one) => html`<g><title>${`lens ${one.number}`}</title><circle class="cell" cx=${one.design[0]} cy=${-one.design[1]} r=${0.018 * reach} vector-effect="non-scaling-stroke" /><text x=${one.design[0] - 0.05 * reach} y=${-one.design[1] + 0.03 * reach} font-size=${0.085 * reach} text-anchor="end">${one.number}</text><path class="arrow" vector-effect="non-scaling-stroke" d=${arrow(one)} /></g>`)}
    </svg><p class="quiet">Measured minus nominal, x to the right, y up; the longest arrow is ${quantity(most, "mm")}.</p>`}
    <table class="small"><thead><tr><th>lens</th><th class="number">dx, µm</th><th class="number">dy, µm</th><th class="number">dz, nm</th><th class="number">ΔR, µm</th><th class="number">Sq, nm</th></tr></thead>
      <tbody>${lenslets.map((one) => html`<tr title=${one.finding}><th scope="row">${one.number}</th>${[0, 1].map((axis) => html`<td class="number">${one.centre[axis] === null ? "–" : number((one.centre[axis] - one.design[axis]) * 1e3)}</td>`)}
        <td class="number">${one.height === null ? "–" : number(one.height * 1e6)}</td><td class="number">${one.radius_error === null ? "–" : number(one.radius_error * 1e3)}</td><td class="number">${number(one.sq_nm)}</td></tr>`)}</tbody></table></section>`;
}

// ---------------------------------------------------------------------------------------------------------- the panel

function Panel() {
  const { measurement, about } = useStore(["measurement", "about"]);
  const [sent, setSent] = useState(null);
  const [lone, setLone] = useState(null);
  useEffect(() => {
    sending = setSent;
    showing = setLone;
    return () => (sending = showing = () => {});
  }, []);
  const types = about?.limits.map_types;
  if (lone && !sent && !measurement) return html`<${Lone} packed=${lone} />`;
  if (!measurement || sent || measurement.state === "failed") return html`<${Drop} sent=${sent} types=${types} />`;
  if (GOING.has(measurement.state)) {
    const { progress } = measurement;
    return html`<div class="drop"><h3>${measurement.name ?? "Measurement"}</h3><${Bar} share=${progress?.fraction ?? 0} kind="going" /><p role="status">${progress?.stage ?? "waiting"}</p></div>`;
  }
  return html`<div class="measure" id="measured"><${Seen} measurement=${measurement} /><${Map_} measurement=${measurement} /><${Findings} key=${measurement.id} measurement=${measurement} /></div>`;
}

export function mount(element) {
  render(html`<${Panel} />`, element);
  return {
    destroy: () => {
      halt();
      render(null, element);
    },
  };
}
