/* Maps of a run, or any packed map: wheel and pinch zoom down to single cusps, pan, profile lines, read-out.

   The picture that is there is drawn at once wherever the view goes; the finer one is asked for when the view rests, and
   only the answer to the last question counts. Rows of a map run from low to high y, pictures from the top down. */

import { getPacked } from "./api.js";
import { drawBar, fitted, formatted, inks, paint, scaleOf, spanned, tableOf, ticks, tickText } from "./colour.js";
import { mountProfile } from "./charts.js";
import { CLIENT, element, framed } from "./dom.js";
import { on, say, set, state } from "./state.js";
import { length } from "./ui.js";

const MARGIN = { left: 62, right: 12, top: 10, bottom: 34 };
const REST_MS = 90;
const PATIENCE_MS = 700;
const FINEST = 2e-6;

/** A picture: values over an extent, as pixels of a canvas. */
class Picture {
  constructor(packed) {
    const { header, arrays } = packed;
    const { data, shape } = arrays.values;
    Object.assign(this, { header, values: data, rows: shape[0], columns: shape[1], x: header.x, y: header.y });
    this.canvas = new OffscreenCanvas(this.columns, this.rows);
    this.image = new ImageData(this.columns, this.rows);
    this.pixels = new Uint32Array(this.image.data.buffer);
    this.key = "";
  }

  get step() {
    return (this.x[1] - this.x[0]) / (this.columns - 1);
  }

  colour(low, high, name) {
    const key = `${low} ${high} ${name}`;
    if (key === this.key) return;
    this.key = key;
    paint(this.values, this.columns, this.rows, low, high, name, this.pixels);
    this.canvas.getContext("2d").putImageData(this.image, 0, 0);
  }

  at(x, y) {
    const column = Math.round(((x - this.x[0]) / (this.x[1] - this.x[0])) * (this.columns - 1));
    const row = Math.round(((y - this.y[0]) / (this.y[1] - this.y[0])) * (this.rows - 1));
    if (column < 0 || row < 0 || column >= this.columns || row >= this.rows) return NaN;
    return this.values[row * this.columns + column];
  }

  covers(view) {
    const slack = 1e-9;
    return this.x[0] <= view.x0 + slack && this.x[1] >= view.x1 - slack && this.y[0] <= view.y0 + slack && this.y[1] >= view.y1 - slack;
  }
}

/** An interactive map.

    `load(window, signal)` returns the packed map of {x0, x1, y0, y1, nx, ny}, or of all of it for null; `finer` is false
    for a map that has no more to show. Calls: `moved(window)`, `pointed([x, y] | null)`, `lined(line)`. */
export class MapView {
  constructor(box, { load, finer = true, label = "error, cut − design", calls = {} }) {
    Object.assign(this, { box, load, finer, label, calls });
    this.view = null;
    this.whole = null;
    this.fine = null;
    this.line = null;
    this.cursor = null;
    this.held = null;
    this.pace = 0;
    this.lining = false;
    this.pointers = new Map();
    this.canvas = element("canvas", {
      class: "mapcanvas", tabindex: 0, role: "application",
      "aria-label": "Map. Arrow keys move it, plus and minus zoom, Home shows all of it, L draws a profile along the middle.",
    });
    this.bar = element("canvas", { class: "mapbar", role: "img", "aria-label": "Colour bar" });
    this.readout = element("output", { class: "readout" });
    this.waiting = element("span", { class: "mapwait", hidden: true }, ["finer …"]);
    box.classList.add("mapview");
    box.append(element("div", { class: "mapmain" }, [this.canvas, this.waiting]), this.bar, this.readout);
    this.draw = framed(() => this.drawNow());
    this.sized = new ResizeObserver(() => {
      if (this.canvas.clientWidth > 30 && this.view) {
        this.view = this.fit ? this.entire() : this.shaped({ ...this.view, y0: (this.view.y0 + this.view.y1) / 2, y1: (this.view.y0 + this.view.y1) / 2 });
        this.rest();
      }
      this.draw();
    });
    this.sized.observe(this.canvas);
    this.unheard = on("theme", () => requestAnimationFrame(() => this.draw()));
    this.listen();
  }

  destroy() {
    this.sized.disconnect();
    this.unheard();
    this.asking?.abort();
    clearTimeout(this.resting);
    this.box.replaceChildren();
  }

  /** Clear the map and load it again, at a `window` if one is given. */
  async open(window = null) {
    this.asking?.abort();
    clearTimeout(this.resting);
    const asking = (this.asking = new AbortController());
    this.fine = null;
    this.busy(!this.whole);
    try {
      const whole = new Picture(await this.load(null, asking.signal));
      if (asking.signal.aborted) return;
      this.whole = whole;
      this.fit = !window;
      this.view = window ? this.shaped(window) : this.entire();
      this.draw();
      this.busy(false);
      if (window) this.rest();
    } catch (error) {
      if (error.name !== "AbortError") say(error.message, "bad");
    }
  }

  /** Disable the controls until the map is loaded. */
  busy(yes) {
    this.canvas.setAttribute("aria-busy", String(yes));
    this.calls.busy?.(yes);
  }

  /** Fit a view to the canvas with equal scales, around the same centre. */
  shaped({ x0, x1, y0, y1 }) {
    const { width, height } = this.room();
    const scale = Math.max((x1 - x0) / width, (y1 - y0) / height, FINEST / 50);
    const [x, y] = [(x0 + x1) / 2, (y0 + y1) / 2];
    return { x0: x - (scale * width) / 2, x1: x + (scale * width) / 2, y0: y - (scale * height) / 2, y1: y + (scale * height) / 2 };
  }

  /** The whole map with a margin. */
  entire() {
    const [x, y] = [this.whole.x, this.whole.y];
    const air = 0.02 * (x[1] - x[0]);
    return this.shaped({ x0: x[0] - air, x1: x[1] + air, y0: y[0] - air, y1: y[1] + air });
  }

  room() {
    return {
      width: Math.max(20, this.canvas.clientWidth - MARGIN.left - MARGIN.right),
      height: Math.max(20, this.canvas.clientHeight - MARGIN.top - MARGIN.bottom),
    };
  }

  toPart(px, py) {
    const { width, height } = this.room();
    const { x0, x1, y0, y1 } = this.view;
    return [x0 + ((px - MARGIN.left) / width) * (x1 - x0), y1 - ((py - MARGIN.top) / height) * (y1 - y0)];
  }

  toScreen(x, y) {
    const { width, height } = this.room();
    const { x0, x1, y0, y1 } = this.view;
    return [MARGIN.left + ((x - x0) / (x1 - x0)) * width, MARGIN.top + ((y1 - y) / (y1 - y0)) * height];
  }

  /** The view has moved: draw the present pictures, and request a finer one when it stops. */
  move(view) {
    const limit = 1.6 * Math.max(this.whole.x[1] - this.whole.x[0], this.whole.y[1] - this.whole.y[0]);
    const size = Math.min(view.x1 - view.x0, view.y1 - view.y0);
    if (size > limit && size > Math.min(this.view.x1 - this.view.x0, this.view.y1 - this.view.y0)) return;
    this.fit = false;
    this.view = view;
    this.draw();
    this.rest();
  }

  rest() {
    this.asking?.abort();
    clearTimeout(this.resting);
    if (!this.whole) return;
    this.calls.moved?.(this.view);
    if (this.finer) this.resting = setTimeout(() => this.sharpen(), REST_MS);
  }

  /** Request the window in view if the present picture is too coarse. */
  async sharpen() {
    if (this.canvas.clientWidth < 30) return;
    const { x0, x1, y0, y1 } = this.view;
    const { width } = this.room();
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const pixel = (x1 - x0) / width / ratio;
    if (this.whole.step < 1.3 * pixel && this.whole.covers(this.view)) {
      this.fine = null;
      this.draw();
      return;
    }
    if (this.fine && this.fine.step < 1.3 * pixel && this.fine.covers(this.view)) return;
    const [wx, wy] = [this.whole.x, this.whole.y];
    const polar = this.whole.header.stored_pixel !== undefined && this.whole.header.name === "whole part";
    // Slightly larger than the view, so that a small move needs no request; never beyond the part.
    const beyond = 0.06 * (x1 - x0);
    const rim = polar ? [Math.max(wx[0], x0 - beyond), Math.min(wx[1], x1 + beyond), Math.max(wy[0], y0 - beyond), Math.min(wy[1], y1 + beyond)] : [x0 - beyond, x1 + beyond, y0 - beyond, y1 + beyond];
    if (!(rim[1] - rim[0] > FINEST / 2) || !(rim[3] - rim[2] > FINEST / 2)) return;
    const count = (span) => Math.max(2, Math.min(1100, Math.round(span / pixel) + 1));
    const asking = (this.asking = new AbortController());
    this.waiting.hidden = false;
    const wide = rim[1] - rim[0];
    const high = rim[3] - rim[2];
    try {
      const [nx, ny] = [count(wide), count(high)];
      // Request a coarse window first if the last one took long.
      for (const parts of this.pace * nx * ny > PATIENCE_MS ? [3, 1] : [1]) {
        const [columns, rows] = [nx, ny].map((one) => Math.max(2, Math.round(one / parts)));
        const from = performance.now();
        const packed = await this.load({ x0: rim[0], x1: rim[1], y0: rim[2], y1: rim[3], nx: columns, ny: rows }, asking.signal);
        if (asking.signal.aborted) return;
        this.pace = (performance.now() - from) / (columns * rows);
        this.fine = new Picture(packed);
        this.draw();
      }
    } catch (error) {
      if (error.name !== "AbortError" && error.status !== 409) say(error.message, "bad");
    }
    if (this.asking === asking) this.waiting.hidden = true;
  }

  zoom(factor, px, py) {
    const [x, y] = this.toPart(px, py);
    const { x0, x1, y0, y1 } = this.view;
    if ((x1 - x0) * factor < FINEST) return;
    this.move({ x0: x + (x0 - x) * factor, x1: x + (x1 - x) * factor, y0: y + (y0 - y) * factor, y1: y + (y1 - y) * factor });
  }

  pan(dx, dy) {
    const { width, height } = this.room();
    const { x0, x1, y0, y1 } = this.view;
    const [mx, my] = [(-dx / width) * (x1 - x0), (dy / height) * (y1 - y0)];
    this.move({ x0: x0 + mx, x1: x1 + mx, y0: y0 + my, y1: y1 + my });
  }

  all() {
    if (!this.whole) return;
    this.move(this.entire());
    this.fit = true;
  }

  setLine(line) {
    this.line = line;
    this.draw();
  }

  setCursor(cursor) {
    this.cursor = cursor;
    this.draw();
  }

  listen() {
    const place = (event) => {
      const box = this.canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    this.canvas.addEventListener("wheel", (event) => {
      if (!this.view) return;
      event.preventDefault();
      const pixels = event.deltaY * (event.deltaMode === 1 ? 16 : event.deltaMode === 2 ? 400 : 1);
      this.zoom(Math.exp(Math.max(-240, Math.min(240, pixels)) * 0.0022), ...place(event));
    }, { passive: false });
    this.canvas.addEventListener("pointerdown", (event) => {
      if (!this.view) return;
      this.canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, place(event));
      if (this.pointers.size === 1 && (this.lining || event.shiftKey || event.button === 2)) {
        const [x, y] = this.toPart(...place(event));
        this.drawing = { x0: x, y0: y, x1: x, y1: y };
      } else this.drawing = null;
    });
    this.canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    this.canvas.addEventListener("pointermove", (event) => {
      if (!this.view) return;
      const here = place(event);
      const before = this.pointers.get(event.pointerId);
      if (!before) return this.point(here);
      if (this.drawing) {
        [this.drawing.x1, this.drawing.y1] = this.toPart(...here);
        this.setLine({ ...this.drawing });
      } else if (this.pointers.size === 2) {
        const other = [...this.pointers].find(([id]) => id !== event.pointerId)[1];
        const gap = (a, b) => Math.max(8, Math.hypot(a[0] - b[0], a[1] - b[1]));
        const middle = (a, b) => [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
        const [was, is] = [middle(before, other), middle(here, other)];
        this.pan(is[0] - was[0], is[1] - was[1]);
        this.zoom(gap(before, other) / gap(here, other), ...is);
      } else this.pan(here[0] - before[0], here[1] - before[1]);
      this.pointers.set(event.pointerId, here);
      return undefined;
    });
    const up = (event) => {
      this.pointers.delete(event.pointerId);
      if (!this.drawing) return;
      const { x0, y0, x1, y1 } = this.drawing;
      const [a, b] = [this.toScreen(x0, y0), this.toScreen(x1, y1)];
      const long = Math.hypot(a[0] - b[0], a[1] - b[1]) > 4;
      const line = long ? this.drawing : null;
      this.drawing = null;
      this.setLine(line);
      this.calls.lined?.(line);
    };
    this.canvas.addEventListener("pointerup", up);
    this.canvas.addEventListener("pointercancel", up);
    this.canvas.addEventListener("pointerleave", () => {
      this.readout.textContent = "";
      this.calls.pointed?.(null);
    });
    this.canvas.addEventListener("dblclick", () => this.all());
    this.canvas.addEventListener("keydown", (event) => {
      if (!this.view || event.ctrlKey || event.metaKey || event.altKey) return;
      const { width, height } = this.room();
      const middle = [MARGIN.left + width / 2, MARGIN.top + height / 2];
      const by = event.shiftKey ? 160 : 40;
      const act = {
        ArrowLeft: () => this.pan(by, 0), ArrowRight: () => this.pan(-by, 0), ArrowUp: () => this.pan(0, by), ArrowDown: () => this.pan(0, -by),
        "+": () => this.zoom(0.8, ...middle), "=": () => this.zoom(0.8, ...middle), "-": () => this.zoom(1.25, ...middle),
        Home: () => this.all(), l: () => this.across(), L: () => this.across(),
      }[event.key];
      if (!act) return;
      event.preventDefault();
      event.stopPropagation();
      act();
    });
  }

  /** Draw the profile along the middle of the view, by keyboard. */
  across() {
    const { x0, x1, y0, y1 } = this.view;
    const line = { x0: x0 + 0.1 * (x1 - x0), x1: x1 - 0.1 * (x1 - x0), y0: (y0 + y1) / 2, y1: (y0 + y1) / 2 };
    this.setLine(line);
    this.calls.lined?.(line);
  }

  point(here) {
    const [x, y] = this.toPart(...here);
    const value = this.valueAt(x, y);
    const span = this.view.x1 - this.view.x0;
    const digits = Math.max(1, Math.min(6, Math.ceil(-Math.log10(span / 2000))));
    const where = `x ${x.toFixed(digits)} mm, y ${y.toFixed(digits)} mm`.replaceAll("-", "−");
    const unit = this.whole.header.unit;
    this.readout.textContent = `${where}   ${Number.isFinite(value) ? formatted(value, unit, 4) : "no value"}`;
    this.calls.pointed?.([x, y]);
  }

  valueAt(x, y) {
    const fine = this.fine?.at(x, y);
    return fine !== undefined && !Number.isNaN(fine) ? fine : this.whole?.at(x, y) ?? NaN;
  }

  /** The colour range: the values in view without the extremes. */
  range() {
    if (this.held) return this.held;
    const shown = this.fine && this.fine.covers(this.view) ? this.fine : this.whole;
    const { p1, p99, low, high, diverging } = shown.header;
    let [least, most] = [p1 ?? low, p99 ?? high];
    if (least === null || least === undefined) return [0, 1];
    if (diverging) {
      most = Math.max(Math.abs(least), Math.abs(most)) || 1e-9;
      least = -most;
    }
    return spanned(least, most);
  }

  drawNow() {
    const { context, width, height } = fitted(this.canvas);
    const colours = inks();
    context.clearRect(0, 0, width, height);
    if (!this.view || !this.whole) return;
    const room = this.room();
    const { header } = this.whole;
    const [low, high] = this.range();
    const name = tableOf(header.diverging, state.theme);
    context.save();
    context.beginPath();
    context.rect(MARGIN.left, MARGIN.top, room.width, room.height);
    context.clip();
    context.fillStyle = colours.sunken;
    context.fillRect(MARGIN.left, MARGIN.top, room.width, room.height);
    for (const picture of [this.whole, this.fine]) {
      if (!picture) continue;
      picture.colour(low, high, name);
      const [half, halfUp] = [picture.step / 2, (picture.y[1] - picture.y[0]) / (picture.rows - 1) / 2];
      const [left, top] = this.toScreen(picture.x[0] - half, picture.y[1] + halfUp);
      const [right, bottom] = this.toScreen(picture.x[1] + half, picture.y[0] - halfUp);
      // Enlarged pixels stay squares: no interpolation.
      context.imageSmoothingEnabled = (right - left) / picture.columns < 1;
      context.drawImage(picture.canvas, left, top, right - left, bottom - top);
    }
    this.drawMarks(context, colours);
    context.restore();
    this.drawAxes(context, colours, room);
    const clipped = header.p1 !== undefined;
    drawBar(this.bar, { low, high, unit: header.unit, label: this.label, name, clipped });
  }

  drawMarks(context, colours) {
    if (this.line) {
      const [a, b] = [this.toScreen(this.line.x0, this.line.y0), this.toScreen(this.line.x1, this.line.y1)];
      for (const [wide, colour] of [[4, colours.face], [1.8, colours.ink]]) {
        Object.assign(context, { strokeStyle: colour, lineWidth: wide, lineCap: "round" });
        context.beginPath();
        context.moveTo(...a);
        context.lineTo(...b);
        context.stroke();
      }
      for (const [end, fill] of [[a, colours.ink], [b, colours.face]]) {
        Object.assign(context, { fillStyle: fill, strokeStyle: colours.ink, lineWidth: 1.6 });
        context.beginPath();
        context.arc(...end, 4, 0, 7);
        context.fill();
        context.stroke();
      }
    }
    if (this.cursor) {
      const [x, y] = this.toScreen(...this.cursor);
      for (const [wide, colour] of [[3.4, colours.face], [1.4, colours.ink]]) {
        Object.assign(context, { strokeStyle: colour, lineWidth: wide });
        context.beginPath();
        for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
          context.moveTo(x + 4 * dx, y + 4 * dy);
          context.lineTo(x + 11 * dx, y + 11 * dy);
        }
        context.stroke();
      }
    }
  }

  drawAxes(context, colours, room) {
    const { x0, x1, y0, y1 } = this.view;
    const scale = scaleOf("mm", x1 - x0 < 0.2 ? 0.01 : 1);
    // Close up and far from the axis, ticks are relative to a round offset that is shown.
    const origin = (low, high) => {
      const span = high - low;
      if (Math.max(Math.abs(low), Math.abs(high)) < 60 * span) return 0;
      const step = 10 ** Math.ceil(Math.log10(span));
      return Math.round((low + high) / 2 / step) * step;
    };
    Object.assign(context, { strokeStyle: colours.line, lineWidth: 1, font: `11px ${colours.font}` });
    context.strokeRect(MARGIN.left - 0.5, MARGIN.top - 0.5, room.width + 1, room.height + 1);
    for (const [axis, low, high] of [["x", x0, x1], ["y", y0, y1]]) {
      const along = axis === "x" ? room.width : room.height;
      const from = origin(low, high);
      const marks = ticks((low - from) * scale.factor, (high - from) * scale.factor, Math.max(2, along / (axis === "x" ? 90 : 45)));
      const title = `${axis}${from ? ` − ${from.toPrecision(6).replace(/\.?0+$/, "")} mm` : ""}  [${scale.unit}]`.replace("− -", "+ ");
      context.fillStyle = colours.quiet;
      for (const mark of marks) {
        const at = mark / scale.factor + from;
        const [px, py] = this.toScreen(axis === "x" ? at : x0, axis === "y" ? at : y0);
        context.strokeStyle = colours.edge;
        context.beginPath();
        if (axis === "x") {
          context.moveTo(px, MARGIN.top + room.height);
          context.lineTo(px, MARGIN.top + room.height + 4);
          Object.assign(context, { textAlign: "center", textBaseline: "top" });
          context.fillText(tickText(mark, marks), px, MARGIN.top + room.height + 5);
        } else {
          context.moveTo(MARGIN.left - 4, py);
          context.lineTo(MARGIN.left, py);
          Object.assign(context, { textAlign: "right", textBaseline: "middle" });
          context.fillText(tickText(mark, marks), MARGIN.left - 6, py);
        }
        context.stroke();
      }
      context.fillStyle = colours.ink;
      if (axis === "x") {
        Object.assign(context, { textAlign: "right", textBaseline: "bottom" });
        context.fillText(title, MARGIN.left + room.width, this.canvas.clientHeight - 1);
      } else {
        context.save();
        context.translate(10, MARGIN.top);
        context.rotate(-Math.PI / 2);
        Object.assign(context, { textAlign: "right", textBaseline: "middle" });
        context.fillText(title, 0, 0);
        context.restore();
      }
    }
  }
}

/** The panel of the maps of a run: choice of map and quantity, the map, and its profile line. */
export function mount(panel) {
  const teach = element("div", { class: "teach" }, [
    element("h3", {}, ["Maps, down to single cusps"]),
    element("p", {}, ["The simulated surface of a finished run is shown here, as cut minus nominal surface in nanometres. Turn the wheel to zoom: every window is simulated from the program. Draw a line for a profile."]),
  ]);
  const names = element("select", { "aria-label": "Map", onchange: () => set({ map: names.value, window: null, line: null }) });
  const quantity = element("select", { "aria-label": "Quantity", onchange: () => open() }, [
    element("option", { value: "error" }, ["error, cut − nominal"]), element("option", { value: "height" }, ["height of the cut surface"]),
  ]);
  const lining = element("button", { type: "button", class: "button", "aria-pressed": "false", title: "Draw a line for a profile (or drag with Shift)" }, ["Profile line"]);
  const all = element("button", { type: "button", class: "button", title: "All of the map (Home, double click)" }, ["Whole map"]);
  const hold = element("button", { type: "button", class: "button", "aria-pressed": "false", title: "Keep the colour range while zooming" }, ["Hold colours"]);
  const about = element("span", { class: "quiet" });
  const bar = element("div", { class: "bar mapbarrow" }, [names, quantity, lining, hold, all, element("span", { class: "gap" }), about]);
  const box = element("div", { class: "mapbox" });
  const side = element("div", { class: "mapside" });
  const body = element("div", { class: "mapbody" }, [box, side]);
  panel.append(teach, bar, body);

  let shown = null;
  const profile = mountProfile(side);
  const describe = (packed) => {
    const { source, pixel, mean_of: many } = packed.header;
    const from = source === "generated" ? "simulated from the program" : many > 1 ? `mean of ${many} stored heights per pixel` : "as stored";
    about.textContent = `${from}, pixel ${length(pixel)}`;
    return packed;
  };
  const view = new MapView(box, {
    load: async (window, signal) => {
      const asked = { name: shown.map, quantity: quantity.value, ...(window ?? {}), client: window ? CLIENT : undefined };
      return describe(await getPacked(`/runs/${shown.run}/map`, asked, { signal }));
    },
    calls: {
      busy: (yes) => {
        for (const one of [lining, hold, all]) one.disabled = yes;
      },
      moved: (window) => set({ window: view.fit ? null : { ...window } }),
      pointed: (cursor) => set({ cursor }),
      lined: (line) => {
        press(false);
        set({ line });
      },
    },
  });
  const press = (value) => {
    view.lining = value;
    lining.setAttribute("aria-pressed", String(value));
    box.classList.toggle("lining", value);
  };
  lining.addEventListener("click", () => press(!view.lining));
  all.addEventListener("click", () => view.all());
  hold.addEventListener("click", () => {
    view.held = view.held ? null : view.range();
    hold.setAttribute("aria-pressed", String(Boolean(view.held)));
    view.draw();
  });

  const open = () => {
    const { run, map, maps } = state;
    const there = Boolean(run && map && maps.length);
    teach.hidden = there;
    bar.hidden = body.hidden = !there;
    if (!there) {
      shown = null;
      return;
    }
    names.replaceChildren(...maps.map((one) => element("option", { value: one.name, selected: one.name === map }, [one.name])));
    const same = shown && shown.run === run && shown.map === map;
    shown = { run, map };
    view.label = quantity.value === "error" ? "cut − design" : "height";
    view.held = null;
    hold.setAttribute("aria-pressed", "false");
    view.open(same && !view.fit ? view.view : null);
  };
  const unheard = [
    on(["run", "maps", "map"], open, { now: true }),
    on("line", ({ line }) => {
      view.setLine(line);
    }, { now: true }),
    on("cursor", ({ cursor }) => view.setCursor(cursor)),
  ];
  return {
    destroy() {
      unheard.forEach((stop) => stop());
      profile.destroy();
      view.destroy();
      panel.replaceChildren();
    },
  };
}
