/* Charts: profile along a line, axis motion and limits, spectrum, and time over radius. */

import Plot from "./vendor/uplot.js";
import { getPacked } from "./api.js";
import { inks, formatted, scaleOf, ticks, tickText } from "./colour.js";
import { CLIENT, element } from "./dom.js";
import { on, say, set, state } from "./state.js";
import { count, duration, number } from "./ui.js";

/** Series differ in colour and dash. */
const SERIES = {
  light: ["#0b5c7a", "#b2540b", "#5b3f96", "#0d6b58", "#8a1c4a"],
  dark: ["#6cc4e4", "#f0a35e", "#b9a2f2", "#63c7ae", "#f08bb4"],
};
const DASHES = [[], [7, 3], [2, 3], [9, 3, 2, 3], [12, 4]];

export function seriesColour(index) {
  const colours = SERIES[state.theme] ?? SERIES.light;
  return colours[index % colours.length];
}

function axis(label, unit, colours, { side, log = false, size } = {}) {
  return {
    stroke: () => inks().quiet,
    font: `11px ${colours.font}`,
    labelFont: `11px ${colours.font}`,
    label: unit ? `${label}  [${unit}]` : label,
    labelSize: 18,
    labelGap: 0,
    side,
    size: size ?? (side === 2 ? 28 : 54),
    gap: 4,
    grid: { stroke: () => inks().sunken, width: 1, ...(log ? { filter: decades } : {}) },
    ticks: { stroke: () => inks().edge, width: 1, size: 4, ...(log ? { filter: decades } : {}) },
    ...(log
      ? { filter: decades, values: (_plot, splits) => splits.map((one) => (one === null ? "" : powerText(one))) }
      : { splits: (plot, _index, low, high) => ticks(low, high, Math.max(2, (side === 2 ? plot.bbox.width / 90 : plot.bbox.height / 40) / devicePixelRatio)), values: (_plot, splits) => splits.map((one) => tickText(one, splits)) }),
  };
}

/** Labels at powers of ten only on a logarithmic axis. */
function decades(_plot, splits) {
  return splits.map((one) => (one !== null && Math.abs(Math.log10(one) - Math.round(Math.log10(one))) < 1e-9 ? one : null));
}

function powerText(value) {
  const power = Math.round(Math.log10(value));
  if (power >= -2 && power <= 3) return String(Number(value.toPrecision(1)));
  return `10${[...String(power)].map((sign) => (sign === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(sign)])).join("")}`;
}

/** A chart that follows the size of its box and the theme.

    `x` and each of `series` is {label, unit, values, dash?, band?, fill?}; `limits` are values of y drawn across;
    `empty` is the text without data. Returns {destroy, at(call)}: `at` receives the index under the pointer, or null. */
export function chart(box, { x, series, limits = [], logX = false, logY = false, title = "", yRange = null, label = "", pointed = null }) {
  let plot = null;
  const figure = element("figure", { class: "chart", "aria-label": label || title });
  if (title) figure.append(element("figcaption", {}, [title]));
  const host = element("div", { class: "charthost" });
  figure.append(host);
  box.append(figure);

  const build = () => {
    plot?.destroy();
    const [width, height] = [host.clientWidth, host.clientHeight];
    if (width < 40 || height < 40) {
      plot = null;
      return;
    }
    const colours = inks();
    const data = [x.values, ...series.map((one) => one.values)];
    const bands = series.flatMap((one, index) => (one.band ? [{ series: [index + 1, index], fill: `${seriesColour(one.colour ?? index)}2e` }] : []));
    plot = new Plot({
      width, height, legend: { show: false }, padding: [10, 20, 0, 0],
      cursor: { y: false, points: { size: 6 }, drag: { x: true, y: false }, focus: { prox: 30 } },
      scales: {
        x: { time: false, distr: logX ? 3 : 1 },
        y: { distr: logY ? 3 : 1, range: yRange ?? ((_plot, low, high) => spread(low, high, limits, logY)) },
      },
      axes: [axis(x.label, x.unit, colours, { side: 2, log: logX, size: 30 }), axis(series[0].axis ?? series[0].label, series[0].unit, colours, { side: 3, log: logY })],
      series: [{}, ...series.map((one, index) => ({
        label: one.label, stroke: seriesColour(one.colour ?? index), width: one.width ?? 1.4, dash: DASHES[one.dash ?? 0], points: { show: false }, spanGaps: false,
      }))],
      bands,
      hooks: {
        draw: [(drawn) => drawLimits(drawn, limits, colours, logY)],
        setCursor: [(drawn) => {
          const at = drawn.cursor.idx;
          output.textContent = at === null || at === undefined ? "" : [`${x.label} ${number(x.values[at], 4)}\u202f${x.unit}`, ...series.filter((one) => !one.silent).map((one) => `${one.label} ${number(one.values[at], 4)}\u202f${one.unit ?? ""}`)].join("   ");
          pointed?.(at ?? null);
        }],
      },
    }, data, host);
  };
  const output = element("output", { class: "chartout" });
  figure.append(output);
  const sized = new ResizeObserver(() => {
    if (!plot) return build();
    return plot.setSize({ width: host.clientWidth, height: host.clientHeight });
  });
  sized.observe(host);
  const unheard = on("theme", () => requestAnimationFrame(build));
  return {
    destroy() {
      sized.disconnect();
      unheard();
      plot?.destroy();
      figure.remove();
    },
  };
}

/** A range with a margin, which includes a limit that is not far beyond the values. */
function spread(low, high, limits, log) {
  if (!Number.isFinite(low) || !Number.isFinite(high)) return [0, 1];
  if (log) return [low / 1.6, high * 1.6];
  let [least, most] = [low, high];
  for (const { value } of limits) {
    if (value > most && value < most + 3 * Math.max(most - least, Math.abs(most))) most = value;
    if (value < least && value > least - 3 * Math.max(most - least, Math.abs(least))) least = value;
  }
  const air = 0.06 * (most - least || Math.abs(most) || 1);
  return [least >= 0 && least < air * 3 ? 0 : least - air, most + air];
}

function drawLimits(plot, limits, colours, log) {
  const { ctx } = plot;
  const ratio = devicePixelRatio;
  ctx.save();
  for (const { value, text } of limits) {
    const { min, max } = plot.scales.y;
    const outside = value > max || value < min;
    const y = outside ? plot.bbox.top + 1 : plot.valToPos(value, "y", true);
    Object.assign(ctx, { strokeStyle: colours.bad, fillStyle: colours.bad, lineWidth: 1.4 * ratio, font: `${11 * ratio}px ${colours.font}`, textAlign: "right" });
    if (!outside) {
      ctx.setLineDash([6 * ratio, 4 * ratio]);
      ctx.beginPath();
      ctx.moveTo(plot.bbox.left, y);
      ctx.lineTo(plot.bbox.left + plot.bbox.width, y);
      ctx.stroke();
    }
    if (log && outside) continue;
    const below = y - plot.bbox.top < 16 * ratio;
    ctx.textBaseline = below ? "top" : "bottom";
    if (text) ctx.fillText(outside ? `${text}, above the range` : text, plot.bbox.left + plot.bbox.width - 4 * ratio, y + (below ? 3 : -3) * ratio);
  }
  ctx.restore();
}

const teach = (title, text) => element("div", { class: "teach" }, [element("h3", {}, [title]), element("p", {}, [text])]);

/** The profile of the line that was drawn on a map. */
export function mountProfile(panel) {
  const box = element("div", { class: "profile" });
  const head = element("div", { class: "bar" });
  const host = element("div", { class: "profilehost" });
  const nothing = teach("A profile along any line", "Open a map, press Profile line (or hold Shift) and drag. Every point is simulated from the program, so single cusps are resolved.");
  box.append(head, host);
  panel.append(nothing, box);
  let drawn = null;
  let asking = null;

  const show = async () => {
    const { run, line } = state;
    nothing.hidden = Boolean(run && line);
    box.hidden = !nothing.hidden;
    asking?.abort();
    if (!run || !line) return;
    const mine = (asking = new AbortController());
    box.classList.add("stale");
    // The first line of a run waits for its program to be read.
    if (!drawn) head.replaceChildren(element("span", { role: "status" }, ["Simulating the surface along the line …"]));
    try {
      const { header, arrays } = await getPacked(`/runs/${run}/profile`, { ...line, n: 2400, client: `${CLIENT}${panel.id}` }, { signal: mine.signal });
      if (mine.signal.aborted) return;
      box.classList.remove("stale");
      draw(header, arrays, line);
    } catch (error) {
      if (error.name !== "AbortError" && error.status !== 409) say(error.message, "bad");
    }
  };

  const draw = (header, arrays, line) => {
    const { low, high, length } = header;
    const across = scaleOf("mm", length < 0.5 ? 0.02 : 1);
    const up = scaleOf("mm", Math.max(Math.abs(low ?? 0), Math.abs(high ?? 0)));
    const share = [...arrays.distance.data].map((one) => one / length);
    const error = arrays.error.data;
    const good = error.filter((one) => !Number.isNaN(one));
    const mean = good.reduce((sum, one) => sum + one, 0) / good.length;
    const rq = Math.sqrt(good.reduce((sum, one) => sum + (one - mean) ** 2, 0) / good.length);
    const place = ([x, y]) => `(${number(x, 5)}, ${number(y, 5)})`;
    head.replaceChildren(
      element("strong", {}, [`PV ${formatted(high - low, "mm")}`]), element("span", {}, [`rms ${formatted(rq, "mm")}`]), element("span", {}, [`length ${formatted(length, "mm")}`]),
      element("span", { class: "quiet" }, [`from ${place([line.x0, line.y0])} to ${place([line.x1, line.y1])} mm, ${count(header.count)} places`]),
    );
    drawn?.destroy();
    drawn = chart(host, {
      label: "Error along the line",
      x: { label: "along the line", unit: across.unit, values: share.map((one) => one * length * across.factor) },
      series: [{ label: "cut − design", unit: up.unit, values: [...error].map((one) => (Number.isNaN(one) ? null : one * up.factor)) }],
      pointed: (at) => set({ cursor: at === null ? null : [line.x0 + share[at] * (line.x1 - line.x0), line.y0 + share[at] * (line.y1 - line.y0)] }),
    });
  };
  const unheard = on(["line", "run"], show, { now: true });
  return {
    destroy() {
      unheard();
      asking?.abort();
      drawn?.destroy();
      panel.replaceChildren();
    },
  };
}

const KINDS = [["position", "Position"], ["speed", "Speed"], ["acceleration", "Acceleration"], ["jerk", "Jerk"]];
const PER = { position: "", speed: "/s", acceleration: "/s²", jerk: "/s³" };

/** Axis motion and limits, the spectrum of an axis, and time over radius. */
export function mountMotion(panel) {
  const nothing = teach("Axis motion", "When a run is done: position, speed, acceleration and jerk of every axis against the limits of the machine, the spectrum of each axis, and the elapsed time over the radius.");
  const kinds = element("div", { class: "segments", role: "radiogroup", "aria-label": "Quantity" });
  const about = element("span", { class: "quiet" });
  const head = element("div", { class: "bar" }, [kinds, about]);
  const grid = element("div", { class: "charts", role: "region", tabindex: "0", "aria-label": "Axis motion and spectrum" });
  const letters = element("select", { "aria-label": "Axis of the spectrum", onchange: () => spectrum() });
  panel.append(nothing, head, grid);
  let kind = "speed";
  let motion = null;
  let shownRun = null;
  let charts = [];
  let asking = null;
  let spectrumBox = null;
  let spectrumChart = null;

  for (const [name, title] of KINDS) {
    kinds.append(element("button", { type: "button", role: "radio", "aria-checked": String(name === kind), "data-kind": name, onclick: () => {
      kind = name;
      for (const one of kinds.children) one.setAttribute("aria-checked", String(one.dataset.kind === kind));
      draw();
    } }, [title]));
  }

  const clear = () => {
    charts.forEach((one) => one.destroy());
    charts = [];
    spectrumChart?.destroy();
    spectrumChart = null;
    grid.replaceChildren();
  };

  const show = async () => {
    const { run, result } = state;
    const there = Boolean(run && result?.program);
    nothing.hidden = there;
    head.hidden = grid.hidden = !there;
    if (!there || run === shownRun) return;
    shownRun = run;
    asking?.abort();
    const mine = (asking = new AbortController());
    about.textContent = "reading the program …";
    clear();
    try {
      motion = await getPacked(`/runs/${run}/motion`, { points: 1600 }, { signal: mine.signal });
      if (!mine.signal.aborted) draw();
    } catch (error) {
      if (error.name === "AbortError") return;
      about.textContent = "";
      say(error.message, "bad");
    }
  };

  const draw = () => {
    if (!motion) return;
    const { header, arrays } = motion;
    clear();
    const long = header.duration_s > 600;
    const times = [...arrays.time.data].map((one) => (long ? one / 60 : one));
    const time = { label: "time", unit: long ? "min" : "s", values: times };
    about.textContent = `${header.pass}: ${count(header.points)} points in ${duration(header.duration_s)} on ${header.machine}; peaks are those of the planned motion; the curves show the written program, whose rounding adds steps`;
    for (const [letter, one] of Object.entries(header.axes)) {
      const turns = letter === "C" && kind === "position";
      const angular = one.unit === "rad";
      const factor = turns ? 1 / (2 * Math.PI) : angular && kind === "speed" ? 30 / Math.PI : 1;
      const unit = turns ? "turns" : angular && kind === "speed" ? "rev/min" : `${one.unit}${PER[kind]}`;
      const values = (name) => [...arrays[name].data].map((value) => value * factor);
      const limit = kind === "position" ? null : one.limits[kind];
      const limits = limit ? [{ value: limit * factor, text: `limit ${number(limit * factor, 3)} ${unit}` }] : [];
      // The machine limits are checked on the motion before rounding in the program.
      const most = header.limits?.[`peak_${kind}`]?.[letter] ?? one.peaks[kind];
      const peak = kind === "position" ? "" : `, peak ${number(most * factor, 3)} ${unit}${limit ? ` (${number((100 * most) / limit, 2)} % of the limit)` : ", no limit stated"}`;
      const box = element("div");
      grid.append(box);
      const title = `${letter}${peak}`;
      const index = Object.keys(header.axes).indexOf(letter);
      charts.push(chart(box, kind === "position"
        ? { x: time, title, series: [{ label: "lowest", axis: `${letter} position`, unit, values: values(`${letter} low`), colour: index, width: 1 }, { label: "highest", unit, values: values(`${letter} high`), band: true, colour: index, width: 1 }] }
        : { x: time, title, limits, series: [{ label: `${kind} of ${letter}`, axis: kind, unit, values: values(`${letter} ${kind}`), colour: index }], yRange: (_plot, low, high) => [0, Math.max(high * (limits.length ? 1.28 : 1.08), limits.length && limits[0].value < 4 * high ? limits[0].value * 1.14 : 0) || 1] }));
    }
    const radii = [...arrays.radius.data];
    const box = element("div");
    grid.append(box);
    const backwards = radii[0] > radii.at(-1);
    const pairs = radii.map((radius, at) => [radius, times[at]]);
    if (backwards) pairs.reverse();
    charts.push(chart(box, {
      title: `Elapsed time, ${backwards ? "from the edge inward" : "from the axis outward"}`, x: { label: "X, radius of the tip", unit: "mm", values: pairs.map(([radius]) => radius) },
      series: [{ label: "elapsed time", unit: time.unit, values: pairs.map(([, passed]) => passed), colour: 3 }],
    }));
    spectrumBox = element("div", { class: "spectrum" });
    grid.append(spectrumBox);
    const choice = letters.value;
    letters.replaceChildren(...Object.keys(header.axes).filter((letter) => letter !== "C").map((letter) => element("option", { value: letter, selected: letter === (choice || "Z") }, [letter])));
    spectrum();
  };

  const spectrum = async () => {
    const mine = asking;
    try {
      const { header, arrays } = await getPacked(`/runs/${shownRun}/spectrum`, { axis: letters.value || "Z" }, { signal: mine.signal });
      if (mine.signal.aborted || !spectrumBox?.isConnected) return;
      spectrumChart?.destroy();
      spectrumBox.replaceChildren();
      const floor = 1e-3;
      const nm = (array) => [...array.data].map((one) => (Number.isNaN(one) ? null : Math.max(one * 1e6, floor)));
      const series = [{ label: "amplitude", unit: "nm", values: nm(arrays.amplitude), colour: 0, width: 1.2 }];
      if (arrays.allowed) series.push({ label: "largest sine within the limits", unit: "nm", values: nm(arrays.allowed), colour: 4, dash: 1 });
      const marks = [header.bandwidth_hz && `bandwidth ${number(header.bandwidth_hz, 3)} Hz`, header.resonance_hz && `servo ${number(header.resonance_hz, 3)} Hz`].filter(Boolean).join(", ");
      spectrumChart = chart(spectrumBox, {
        title: `Spectrum of ${header.axis}${marks ? `: ${marks}` : ""}`, x: { label: "frequency", unit: "Hz", values: [...arrays.frequency.data] }, series, logX: true, logY: true,
        yRange: (_plot, _low, high) => [floor, Math.max(high * 2, 1)],
      });
      spectrumBox.querySelector("figcaption").append(" ", letters);
    } catch (error) {
      if (error.name !== "AbortError") say(error.message, "bad");
    }
  };
  const unheard = on(["run", "result"], show, { now: true });
  return {
    destroy() {
      unheard();
      asking?.abort();
      clear();
      panel.replaceChildren();
    },
  };
}
