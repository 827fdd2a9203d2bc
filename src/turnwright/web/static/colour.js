/* Colours of values: perceptually uniform tables, unit scales, the colour bar.

   Every table has 33 nodes, between which it goes straight in sRGB, made once:
   viridis, cividis   matplotlib's, for values: lightness grows evenly, readable with any colour vision
   light, dark        for errors, blue (hue 250 degrees in OKLCh) below zero and orange (40) above. Lightness goes in equal
                      steps from that of the page at zero, 0.975 or 0.235, to 0.42 or 0.80 at both ends, where it is the
                      same; chroma is c sin(90 degrees min(1, 1.15 t)), t the distance from zero, c 0.17 or 0.15, or the
                      most that a screen shows at that lightness
*/

import { number } from "./ui.js";

const NODES = {
  viridis:
    "440154470d6048186a482374472d7b4537814240863e49893b528b375b8d33638d2f6b8e2c728e297a8e26828e23898e21918c1f988b1fa08822a785" +
    "28ae8032b67a3fbc734ec36b5ec96270cf5784d44b98d83eaddc30c2df23d8e219ece51bfde725",
  cividis:
    "00224e00285b002e6a0533711a386f273e6e32436d3b496c434e6c4b546c535a6d5a5f6e61656f686a716f70737676767d7c788482798c8878938e78" +
    "9b9476a39a74aba072b4a76fbcae6cc4b468cdbb63d5c25edec958e7d150f0d846f9e03afee838",
  light:
    "004f8a00589a0062ab006cbb0076cc1481d92e8ce14397e757a2ed6aadf17eb8f591c3f7a5cef8b9d8f9cee2f9e2edf8f7f7f7f7e7e2f7d8cdf6c9b9" +
    "f5baa5f2ab92ee9c7fe98d6de27e5bdb704ad36239ca5527c04713b43d00a43700943100852b00",
  dark:
    "89c3ff72b8ff58adff4aa1f54096e7388bd93280c92d76b92a6ba9276198265786254d75244463233a5122314020272f1e1e1e2e24203e2a224e2f24" +
    "5f35266f3a287f402a8f462c9f4d2faf5433be5c39cd653fdb6e47e87850f5835bff9069ffa383",
};

const LEVELS = 1024;
const made = new Map();

/** A table as 1024 pixels in the byte order of a canvas. */
export function table(name) {
  if (!made.has(name)) {
    const nodes = Array.from({ length: 33 }, (_, k) => [0, 2, 4].map((at) => parseInt(NODES[name].substr(6 * k + at, 2), 16)));
    const pixels = new Uint32Array(LEVELS);
    const bytes = new Uint8Array(pixels.buffer);
    for (let i = 0; i < LEVELS; i++) {
      const t = (i / (LEVELS - 1)) * 32;
      const k = Math.min(31, Math.floor(t));
      for (let c = 0; c < 3; c++) bytes[4 * i + c] = Math.round(nodes[k][c] + (t - k) * (nodes[k + 1][c] - nodes[k][c]));
      bytes[4 * i + 3] = 255;
    }
    made.set(name, pixels);
  }
  return made.get(name);
}

/** The colour table of a map in the theme of the page. */
export function tableOf(diverging, theme) {
  return diverging ? theme : "viridis";
}

/** Colour values into pixels (a Uint32Array over an image's bytes), rows from the bottom up; no value, no colour. */
export function paint(values, columns, rows, low, high, name, pixels) {
  const colours = table(name);
  const scale = high > low ? (LEVELS - 1) / (high - low) : 0;
  const shift = 0.5 - low * scale;
  for (let row = 0; row < rows; row++) {
    let from = row * columns;
    let to = (rows - 1 - row) * columns;
    for (let column = 0; column < columns; column++, from++, to++) {
      const value = values[from];
      if (value !== value) {
        pixels[to] = 0;
        continue;
      }
      const level = value * scale + shift;
      pixels[to] = colours[level < 0 ? 0 : level >= LEVELS ? LEVELS - 1 : level | 0];
    }
  }
}

/** One colour as CSS has it. */
export function colourAt(share, name) {
  const pixel = table(name)[Math.max(0, Math.min(LEVELS - 1, Math.round(share * (LEVELS - 1))))];
  return `rgb(${pixel & 255} ${(pixel >> 8) & 255} ${(pixel >> 16) & 255})`;
}

/** {factor, unit}: display unit for numbers up to `largest` in a server's unit. */
export function scaleOf(unit, largest) {
  const size = Math.abs(largest);
  if (unit === "mm") {
    if (size >= 0.1) return { factor: 1, unit: "mm" };
    return size >= 5e-3 ? { factor: 1e3, unit: "µm" } : { factor: 1e6, unit: "nm" };
  }
  if (unit === "rad") {
    if (size >= 2e-3) return { factor: 180 / Math.PI, unit: "°" };
    return size >= 1e-5 ? { factor: 1e3, unit: "mrad" } : { factor: 1e6, unit: "µrad" };
  }
  return { factor: 1, unit };
}

const FLOAT32_TOL = 3e-7; // relative resolution of float32

/** The ends of a colour scale; a constant map gets a margin on both sides. */
export function spanned(low, high) {
  const most = Math.max(Math.abs(low), Math.abs(high));
  if (high - low > FLOAT32_TOL * most) return [low, high];
  const half = 0.05 * most || 1e-9;
  return [(low + high) / 2 - half, (low + high) / 2 + half];
}

/** Round numbers between two ends, about `count` of them. */
export function ticks(low, high, count = 5) {
  const span = high - low;
  // No ticks between ends that differ by rounding only.
  if (!(span > 1e-12 * Math.max(Math.abs(low), Math.abs(high))) || !Number.isFinite(span)) return [low];
  const raw = span / Math.max(1, count);
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 2.5, 5, 10].find((one) => one * power >= raw * 0.999) * power;
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * span; k++) found.push(k * step);
  return found;
}

/** Tick labels with enough digits to be distinct. */
export function tickText(value, marks) {
  if (marks.length < 2) return number(value, 4);
  const step = marks[1] - marks[0];
  const decimals = Math.max(0, Math.min(9, Math.ceil(-Math.log10(step) - 1e-9) + (Math.abs(step * 10 ** Math.ceil(-Math.log10(step)) - 2.5) < 1e-6 ? 1 : 0)));
  if (Math.abs(value) < step * 1e-6) return "0";
  if (decimals > 4) return number(value, 2);
  return value.toFixed(decimals).replace("-", "−");
}

/** The current colours of the page style. */
export function inks(element = document.documentElement) {
  const style = getComputedStyle(element);
  const dark = document.documentElement.dataset.theme === "dark";
  const read = (name) => {
    const stated = style.getPropertyValue(`--${name}`).trim();
    const [, light, other] = stated.match(/^light-dark\((.+), (.+)\)$/) ?? [];
    return light ? (dark ? other : light) : stated;
  };
  return Object.fromEntries(["ground", "face", "raised", "sunken", "line", "edge", "ink", "quiet", "accent", "good", "bad", "warn", "font"].map((name) => [name, read(name)]));
}

/** Fit a canvas to its element in device pixels; {context, width, height} in CSS pixels. */
export function fitted(canvas) {
  const ratio = Math.min(3, window.devicePixelRatio || 1);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const [wide, high] = [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
  if (canvas.width !== wide || canvas.height !== high) Object.assign(canvas, { width: wide, height: high });
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, width, height, ratio };
}

/** Draw a vertical colour bar with title and ticks. `low` and `high` in the server's unit. */
export function drawBar(canvas, { low, high, unit, label, name, clipped = false }) {
  const { context, width, height } = fitted(canvas);
  const { ink, quiet, line, font } = inks();
  context.clearRect(0, 0, width, height);
  if (!Number.isFinite(low) || !Number.isFinite(high)) return;
  const scale = scaleOf(unit, Math.max(Math.abs(low), Math.abs(high)));
  const [top, bottom, left, wide] = [clipped ? 41 : 34, height - 14, 2, 13];
  const length = bottom - top;
  for (let y = 0; y < length; y++) {
    context.fillStyle = colourAt(1 - y / (length - 1), name);
    context.fillRect(left, top + y, wide, 1.5);
  }
  context.strokeStyle = line;
  context.strokeRect(left - 0.5, top - 0.5, wide + 1, length + 1);
  context.textBaseline = "middle";
  context.textAlign = "left";
  const marks = ticks(low * scale.factor, high * scale.factor, Math.max(2, Math.floor(length / 34)));
  for (const mark of marks) {
    const share = high > low ? (mark / scale.factor - low) / (high - low) : 0.5;
    const y = bottom - share * length;
    const zero = Math.abs(mark) < 1e-12 * Math.max(Math.abs(low), Math.abs(high)) * scale.factor;
    context.strokeStyle = zero ? ink : quiet;
    context.beginPath();
    context.moveTo(left + wide, y);
    context.lineTo(left + wide + (zero ? 6 : 4), y);
    context.stroke();
    context.fillStyle = ink;
    context.font = `11px ${font}`;
    context.fillText(tickText(mark, marks), left + wide + 8, y);
  }
  context.textBaseline = "alphabetic";
  context.fillStyle = ink;
  context.font = `600 11px ${font}`;
  context.fillText(scale.unit, left, 26);
  context.fillStyle = quiet;
  context.font = `11px ${font}`;
  context.fillText(label, left, 11, width - 2);
  if (clipped) {
    context.fillStyle = quiet;
    for (const [y, way] of [[top - 3, -1], [bottom + 3, 1]]) {
      context.beginPath();
      context.moveTo(left, y);
      context.lineTo(left + wide, y);
      context.lineTo(left + wide / 2, y + 5 * way);
      context.fill();
    }
  }
}

/** A value in a suitable unit. */
export function formatted(value, unit, digits = 3) {
  if (!Number.isFinite(value)) return "–";
  const { factor, unit: shown } = scaleOf(unit, value);
  return `${number(value * factor, digits)}${shown === "°" ? "" : "\u202f"}${shown}`;
}
