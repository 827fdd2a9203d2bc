/* The scene: the part coloured by any map, the spiral of the finishing pass, the tool where the slider puts it, and the
   edge in contact as an inset, to scale and close by.

   World and part frame are one: x, y, z in mm, z toward the tool; heights are drawn larger by a factor that is stated.
   Nothing is drawn while nothing changes. */

import {
  AmbientLight, BufferAttribute, BufferGeometry, CanvasTexture, Color, DataTexture, DirectionalLight, DoubleSide, ExtrudeGeometry, Group, LinearFilter, LineBasicMaterial,
  LineSegments, Mesh, MeshLambertMaterial, MeshStandardMaterial, OrbitControls, PerspectiveCamera, Raycaster, RGBAFormat, RingGeometry, MeshBasicMaterial, Scene, Shape, Sprite, SpriteMaterial,
  SRGBColorSpace, UnsignedByteType, Vector2, Vector3, WebGLRenderer,
} from "./vendor/three.js";
import { getPacked, postPacked } from "./api.js";
import { drawBar, fitted, formatted, inks, paint, scaleOf, spanned, tableOf, ticks, tickText } from "./colour.js";
import { CLIENT, element, framed } from "./dom.js";
import { surfaceOf } from "./seen.js";
import { on, say, set, state } from "./state.js";
import { length, number } from "./ui.js";

const RINGS = 160;
const RAYS = 288;
const POINTS = 6000;
const SHOWN = 0.2;
const STEEPEST = 0.9;
const QUANTITIES = {
  "Current job": [["height", "Height"], ["slope", "Slope"], ["curvature", "Curvature"], ["clearance margin", "Clearance margin"], ["chip thickness", "Chip thickness, estimated"]],
  "Selected run": [["error", "Error, cut − nominal"], ["chips", "Chip thickness"]],
};
/** Results of a run over its part. */
const FOUND = {
  error: (run, options) => getPacked(`/runs/${run}/map`, { name: "whole part", nx: 640, ny: 640 }, options),
  chips: (run, options) => getPacked(`/runs/${run}/chips`, { pixels: 384 }, options),
};
const VIEWS = { iso: [1, -1.5, 0.95], top: [0, -1e-4, 1], side: [0, -1, 0.02] };
const ignored = (error) => error.name === "AbortError" || error.status === 409;

/** A round factor for heights: 1, 2, 5, 10, 20 ... */
function plain(factor) {
  if (factor <= 1.3) return 1;
  const power = 10 ** Math.floor(Math.log10(factor));
  return [1, 2, 5, 10].reduce((best, one) => (Math.abs(Math.log(one * power / factor)) < Math.abs(Math.log(best / factor)) ? one * power : best), power);
}

/** An azimuth from 0.0 to 359.9 degrees. */
const degrees = (angle) => `${(Number((((angle * 180) / Math.PI) % 360).toFixed(1)) % 360).toFixed(1)}°`;

/** The largest of 1, 2, 5, 10 ... that is not larger. */
function round(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return (most >= 5 * power ? 5 : most >= 2 * power ? 2 : 1) * power;
}

/** The vertices of a unit disc, ring by ring from the centre, and its triangles. */
function disc() {
  const count = RINGS * RAYS + 1;
  const places = new Float32Array(2 * count);
  const faces = new Uint32Array(3 * RAYS * (2 * RINGS - 1));
  let filled = 0;
  const face = (a, b, c) => {
    faces[filled++] = a;
    faces[filled++] = b;
    faces[filled++] = c;
  };
  for (let ray = 0; ray < RAYS; ray++) {
    const [cosine, sine] = [Math.cos((2 * Math.PI * ray) / RAYS), Math.sin((2 * Math.PI * ray) / RAYS)];
    const next = (ray + 1) % RAYS;
    face(0, 1 + ray, 1 + next);
    for (let ring = 0; ring < RINGS; ring++) {
      const a = 1 + ring * RAYS;
      places[2 * (a + ray)] = ((ring + 1) / RINGS) * cosine;
      places[2 * (a + ray) + 1] = ((ring + 1) / RINGS) * sine;
      if (ring + 1 === RINGS) continue;
      const b = a + RAYS;
      face(a + ray, b + ray, b + next);
      face(a + ray, b + next, a + next);
    }
  }
  return { places, uv: places.map((one) => 0.5 + one / 2), faces };
}

class View {
  constructor(box) {
    this.box = box;
    box.classList.add("scenebox");
    this.build();
    this.stage();
    this.listen();
  }

  // ------------------------------------------------------------------------------------------------------ elements

  build() {
    this.canvas = element("canvas", {
      class: "scene", tabindex: 0, role: "application",
      "aria-label": "The part. Arrow keys turn it, with Shift they move it, plus and minus zoom, Home shows all of it, comma and full stop move the tool.",
    });
    this.choose = element("select", { "aria-label": "Colour the part by", onchange: () => set({ quantity: this.choose.value }) },
      Object.entries(QUANTITIES).map(([label, group]) => element("optgroup", { label }, group.map(([value, title]) => element("option", { value }, [title])))));
    this.times = element("select", { "aria-label": "Height exaggeration", title: "Heights are exaggerated by this factor", onchange: () => this.exaggerate(this.times.value === "auto" ? null : Number(this.times.value)) });
    const views = [["iso", "Oblique", "From the front, above (Home)"], ["top", "Top", "From above, along z"], ["side", "Side", "From the side, along y"]].map(([name, text, title]) => element("button", { type: "button", class: "button", title, onclick: () => this.show(name) }, [text]));
    const flag = (name, title) => element("label", { class: "flag" }, [element("input", { type: "checkbox", checked: true, onchange: (event) => this.flip(name, event.target.checked) }), title]);
    this.tools = element("div", { class: "scenebar" }, [
      element("label", { class: "flag" }, ["Colour ", this.choose]), element("label", { class: "flag" }, ["z × ", this.times]), flag("path", "Path"), flag("tool", "Tool"), flag("inset", "Contact"), element("span", { class: "gap" }), ...views,
    ]);
    this.bar = element("canvas", { class: "scenecolours", role: "img", "aria-label": "Colour bar" });
    this.inset = element("canvas", { class: "inset", role: "img", "aria-label": "Cutting edge in contact with the part" });
    this.note = element("p", { class: "scenenote" });
    this.readout = element("output", { class: "readout" });
    this.slider = element("input", { type: "range", min: 0, max: 1, step: "any", value: 0, "aria-label": "Position of the tool on the finishing path" });
    this.where = element("output", { class: "where" });
    this.scrub = element("div", { class: "scrub" }, [this.slider, this.where]);
    this.wait = element("span", { class: "mapwait", hidden: true }, ["looking …"]);
    this.insetbox = element("div", { class: "insetbox" }, [this.inset]);
    this.stagebox = element("div", { class: "stage" }, [this.canvas, this.bar, this.insetbox, this.note, this.readout, this.wait]);
    this.box.append(this.tools, this.stagebox, this.scrub);
  }

  // --------------------------------------------------------------------------------------------------------- stage

  stage() {
    this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: true, alpha: true, preserveDrawingBuffer: false });
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio || 1));
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(32, 1, 0.01, 1000);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.enableDamping = false;
    this.controls.zoomSpeed = 1.4;
    this.controls.maxPolarAngle = 1.56;
    this.light = new DirectionalLight(0xffffff, 1.5);
    this.soft = new AmbientLight(0xffffff, 2.1);
    this.scene.add(this.light, this.soft);
    this.part = new Group();
    this.axes = new Group();
    this.scene.add(this.part, this.axes);
    this.disc = disc();
    this.texture = new DataTexture(new Uint8Array(4), 1, 1, RGBAFormat, UnsignedByteType);
    this.face = new Mesh(new BufferGeometry(), new MeshLambertMaterial({ map: this.texture, side: DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 }));
    this.wall = new Mesh(new BufferGeometry(), new MeshLambertMaterial({ side: DoubleSide }));
    this.part.add(this.face, this.wall);
    // Compile the shaders now, in parallel, rather than at the first picture.
    const alike = new Group().add(new LineSegments(new BufferGeometry(), new LineBasicMaterial()), this.label("", "#000"));
    this.scene.add(alike);
    this.renderer.compile(this.scene, this.camera);
    this.scene.remove(alike);
    this.ray = new Raycaster();
    this.draw = framed(() => this.drawNow());
    this.canvas.addEventListener("webglcontextlost", () => {
      this.wrong = "the graphics context was lost; the picture returns when it is restored";
      this.tellNote();
    });
    this.canvas.addEventListener("webglcontextrestored", () => {
      this.wrong = "";
      this.tellNote();
      this.draw();
    });
    this.controls.addEventListener("change", () => this.draw());
    this.sized = new ResizeObserver(() => {
      const { clientWidth: width, clientHeight: height } = this.stagebox;
      if (width < 10 || height < 10) return;
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.stagebox.classList.toggle("low", height < 300);
      this.stagebox.classList.toggle("tiny", height < 130);
      if (this.moved) this.frame();
      else this.look(this.from ?? "iso");
      this.draw();
      this.drawInset();
      this.drawColours();
    });
    this.sized.observe(this.stagebox);
    this.visible = { path: true, tool: true, inset: true };
    this.factor = null;
    this.insetbox.hidden = true;
  }

  drawNow() {
    // The light moves with the camera, so that the shape is visible from every side.
    this.light.position.copy(this.camera.position).add(new Vector3(-0.8, 0.5, 1.1).multiplyScalar(this.camera.position.length() * 0.6));
    const low = this.stagebox.clientHeight < 240;
    for (const sprite of this.axes.children) {
      if (!sprite.isSprite) continue;
      sprite.visible = this.stagebox.clientHeight > 130 && (!low || sprite.userData.pixels > 14);
      const far = sprite.position.distanceTo(this.camera.position);
      const high = (2 * far * Math.tan((this.camera.fov * Math.PI) / 360) * sprite.userData.pixels) / Math.max(1, this.stagebox.clientHeight);
      sprite.scale.set(high * sprite.userData.aspect, high, 1);
    }
    this.renderer.render(this.scene, this.camera);
    if (this.surface) this.box.dataset.drawn = String((Number(this.box.dataset.drawn) || 0) + 1);
  }

  /** Set a view direction on request. */
  show(name) {
    this.moved = false;
    this.look(name);
  }

  /** The free area for the part, its centre, and the areas of colour bar and inset. [px] */
  room() {
    const { clientWidth: width, clientHeight: height } = this.stagebox;
    const [left, right, top, bottom] = [14, width - 10, 10, height - (height < 240 ? 26 : 46)];
    const taken = [this.bar, this.insetbox].filter((one) => one.offsetParent).map((one) => {
      const wide = one === this.bar ? 78 : one.offsetWidth;
      return [one.offsetLeft, one.offsetLeft + wide, one.offsetTop, one.offsetTop + one.offsetHeight];
    });
    const inset = width > 480 && this.insetbox.offsetParent ? this.insetbox.offsetWidth + 14 : 0;
    return { width, height, left, right, top, bottom, taken, across: (84 + right - inset) / 2, down: (top + bottom) / 2 };
  }

  /** Set a view direction, as close as the free area shows the whole part and its axes. */
  look(name) {
    const radius = this.surface?.header.radius ?? 1;
    const { width, height, ...room } = this.room();
    if (width < 10 || height < 10) return;
    this.from = name;
    const ground = this.floor ?? -0.2 * radius;
    const high = this.surface ? this.up(this.surface.header.z_high) : 0.2 * radius;
    const reach = 1.09 * radius;
    const corners = [[reach * 1.07, -reach, ground], [-reach, reach * 1.07, ground], [-reach * 1.06, -reach * 1.06, ground], [-reach, -reach, this.top ?? high]];
    for (let ray = 0; ray < 48; ray++) {
      const [x, y] = [radius * Math.cos((ray * Math.PI) / 24), radius * Math.sin((ray * Math.PI) / 24)];
      corners.push([x, y, ground], [x, y, high]);
    }
    const way = new Vector3(...VIEWS[name]).normalize();
    this.controls.target.set(0, 0, (ground + high) / 2);
    this.camera.clearViewOffset();
    // Axis labels need a margin.
    const [lateral, above] = [22, 13];
    const seenFrom = (away) => {
      this.camera.position.copy(way).multiplyScalar(away).add(this.controls.target);
      Object.assign(this.camera, { near: away / 200, far: away * 20 });
      this.camera.lookAt(this.controls.target);
      this.camera.updateProjectionMatrix();
      this.camera.updateMatrixWorld();
      return corners.map((one) => new Vector3(...one).project(this.camera)).map(({ x, y }) => [((x + 1) / 2) * width, ((1 - y) / 2) * height]);
    };
    const free = (points, dx, dy) => points.every(([x, y]) => room.taken.every(([x0, x1, y0, y1]) => x + dx < x0 - lateral || x + dx > x1 + lateral || y + dy < y0 - above || y + dy > y1 + above));
    const middle = (values) => (Math.min(...values) + Math.max(...values)) / 2;
    let away = 3 * radius;
    for (let turn = 0; turn < 60; turn++, away *= 1.05) {
      const points = seenFrom(away);
      const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
      // The part can be moved only if it is smaller than the free area.
      const [x0, x1] = [room.left + lateral - Math.min(...xs), room.right - lateral - Math.max(...xs)];
      const [y0, y1] = [room.top + above - Math.min(...ys), room.bottom - above - Math.max(...ys)];
      const steps = [0.5, 0.4, 0.6, 0.3, 0.7, 0.2, 0.8, 0.1, 0.9, 0, 1];
      const place = x1 < x0 || y1 < y0 ? null : steps.flatMap((v) => steps.map((u) => [x0 + u * (x1 - x0), y0 + v * (y1 - y0)])).find(([dx, dy]) => free(points, dx, dy));
      if (!place && turn < 59) continue;
      const [dx, dy] = place ?? [room.across - middle(xs), room.down - middle(ys)];
      this.shifted = [-dx, -dy];
      break;
    }
    this.frame();
    Object.assign(this.controls, { minDistance: radius * 0.02, maxDistance: away * 6 });
    this.controls.update();
    this.draw();
  }

  /** Place the part where `look` has found room; after a move, in the middle of the free area. */
  frame() {
    const { width, height, across, down } = this.room();
    const [x, y] = this.shifted && !this.moved ? this.shifted : [width / 2 - across, height / 2 - down];
    this.camera.setViewOffset(width, height, x, y, width, height);
    this.camera.updateProjectionMatrix();
  }

  // ---------------------------------------------------------------------------------------------------- the surface

  /** The job that is drawn: the current one, or that of the run for its results. */
  source() {
    const { quantity, run, made, job } = state;
    return FOUND[quantity] && run && made ? made : job;
  }

  /** Why the selected run cannot colour the part; empty if it can. */
  missing() {
    const { quantity, run, result, maps } = state;
    if (!FOUND[quantity]) return "";
    if (!run || !result?.passes) return "no finished run is selected: choose one under Runs, or run the job";
    if (quantity === "error") return maps.some(({ name }) => name === "whole part") ? "" : "the run has no map of the whole part";
    return result.passes.at(-1).chips ? "" : "the run has no chip data: set part.stock and a known part.material";
  }

  /** Request the surface map of the chosen quantity; only the last answer counts. */
  async askSurface() {
    const { quantity, run } = state;
    const job = this.source();
    if (!job) return;
    this.asking?.abort();
    const mine = (this.asking = new AbortController());
    const { signal } = mine;
    this.wait.hidden = false;
    this.wrong = "";
    try {
      const missing = this.missing();
      const [surface, found] = await Promise.all([
        surfaceOf(job, FOUND[quantity] ? "height" : quantity, signal),
        FOUND[quantity] && !missing ? FOUND[quantity](run, { signal }) : null,
      ]);
      if (signal.aborted) return;
      this.bare = missing || surface.header.refused || "";
      this.setSurface(surface, found);
    } catch (error) {
      if (ignored(error) || mine !== this.asking) return;
      this.wrong = error.message;
      // When the server is available again, the job is checked and the map requested again.
      this.looked = this.followed = null;
    }
    this.wait.hidden = true;
    this.tellNote();
  }

  setSurface(surface, found) {
    const fresh = this.surface?.header.radius !== surface.header.radius;
    this.surface = surface;
    this.found = found;
    this.exaggerate(this.factor, false);
    this.makePart();
    this.colourPart();
    this.makeAxes();
    this.makePath();
    if (fresh) this.show("iso");
    this.placeTool();
    if (!this.moved) this.look(this.from);
    this.draw();
  }

  /** Bilinear interpolation of heights. */
  heightAt(x, y) {
    const { header, arrays } = this.surface;
    const [rows, columns] = arrays.z.shape;
    const z = arrays.z.data;
    const u = Math.max(0, Math.min(columns - 1.000001, ((x - header.x[0]) / (header.x[1] - header.x[0])) * (columns - 1)));
    const v = Math.max(0, Math.min(rows - 1.000001, ((y - header.y[0]) / (header.y[1] - header.y[0])) * (rows - 1)));
    const i = Math.floor(u);
    const j = Math.floor(v);
    const s = u - i;
    const t = v - j;
    const at = j * columns + i;
    return (1 - t) * ((1 - s) * z[at] + s * z[at + 1]) + t * ((1 - s) * z[at + columns] + s * z[at + columns + 1]);
  }

  /** The exaggerated height, scaled about mid-height of the part. */
  up(z) {
    return (z - this.middle) * this.scale;
  }

  /** The slope that almost all of the part stays below. */
  steepness() {
    const { header, arrays } = this.surface;
    const [rows, columns] = arrays.z.shape;
    const z = arrays.z.data;
    const step = (header.x[1] - header.x[0]) / (columns - 1);
    const found = [];
    for (let row = 1; row < rows - 1; row += 3) {
      for (let column = 1; column < columns - 1; column += 3) {
        const at = row * columns + column;
        if (Math.hypot(column - columns / 2, row - rows / 2) < columns / 2 - 2) found.push(Math.hypot(z[at + 1] - z[at - 1], z[at + columns] - z[at - columns]) / (2 * step));
      }
    }
    found.sort((a, b) => a - b);
    return Math.max(found[Math.floor(0.95 * found.length)] ?? 0, 1e-9);
  }

  exaggerate(factor, redo = true) {
    this.factor = factor;
    const { radius, z_low: low, z_high: high } = this.surface.header;
    const span = Math.max(high - low, 1e-12);
    // Exaggerate heights for visibility, up to a limit on slope.
    const natural = Math.max(1, Math.min(1e7, plain(Math.min((SHOWN * 2 * radius) / span, STEEPEST / this.steepness()))));
    this.scale = factor ?? natural;
    this.middle = (low + high) / 2;
    const choices = [...new Set([1, natural / 10, natural / 5, natural / 2, natural, natural * 2, natural * 5].filter((one) => one >= 1).map(plain))].sort((a, b) => a - b);
    this.times.replaceChildren(
      element("option", { value: "auto", selected: factor === null }, [`${natural.toLocaleString("en")} (fits)`]),
      ...choices.map((one) => element("option", { value: one, selected: factor === one }, [one.toLocaleString("en")])),
    );
    if (!redo) return;
    this.makePart();
    this.colourPart();
    this.makeAxes();
    this.makePath();
    this.placeTool();
    if (!this.moved) this.look(this.from);
    this.draw();
  }

  makePart() {
    const { header } = this.surface;
    const radius = header.radius;
    const { places: unit, uv, faces } = this.disc;
    const places = new Float32Array((RINGS * RAYS + 1) * 3);
    for (let at = 0, from = 0; from < unit.length; at += 3, from += 2) {
      places[at] = radius * unit[from];
      places[at + 1] = radius * unit[from + 1];
      places[at + 2] = this.up(this.heightAt(places[at], places[at + 1]));
    }
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(places, 3));
    geometry.setAttribute("uv", new BufferAttribute(uv, 2));
    geometry.setIndex(new BufferAttribute(faces, 1));
    geometry.computeVertexNormals();
    this.face.geometry.dispose();
    this.face.geometry = geometry;
    // The body below the surface.
    const lowest = Math.min(...Array.from({ length: RAYS }, (_, ray) => places[3 * (1 + (RINGS - 1) * RAYS + ray) + 2]), this.up(header.z_low));
    this.floor = lowest - 0.1 * radius;
    const body = new Float32Array(RAYS * 12);
    const sides = [];
    for (let ray = 0; ray < RAYS; ray++) {
      const from = 3 * (1 + (RINGS - 1) * RAYS + ray);
      const [x, y, z] = places.subarray(from, from + 3);
      body.set([x, y, z, x, y, this.floor], 6 * ray);
      const next = (ray + 1) % RAYS;
      sides.push(2 * ray, 2 * ray + 1, 2 * next + 1, 2 * ray, 2 * next + 1, 2 * next);
    }
    const wall = new BufferGeometry();
    wall.setAttribute("position", new BufferAttribute(body.subarray(0, RAYS * 6), 3));
    wall.setIndex(sides);
    wall.computeVertexNormals();
    this.wall.geometry.dispose();
    this.wall.geometry = wall;
  }

  /** The values shown, with their range, unit and label. */
  shown() {
    const of = this.found ?? this.surface;
    const { header } = of;
    if (!header.diverging) {
      const [low, high] = spanned(header.p1 ?? header.low, header.p99 ?? header.high);
      return { of, header, low, high, unit: header.unit, label: header.label };
    }
    const most = Math.max(Math.abs(header.p1), Math.abs(header.p99)) || 1e-9;
    return { of, header, low: -most, high: most, unit: header.unit, label: "cut − design" };
  }

  colourPart() {
    const { of, header, low, high } = this.shown();
    const [rows, columns] = of.arrays.values.shape;
    const pixels = new Uint32Array(rows * columns);
    paint(of.arrays.values.data, columns, rows, low, high, tableOf(header.diverging, state.theme), pixels);
    const plain = new Color(inks().edge);
    // Texture rows run from the bottom, picture rows from the top; missing values have the colour of the bare part.
    const bare = (255 << 24) | (Math.round(255 * plain.b) << 16) | (Math.round(255 * plain.g) << 8) | Math.round(255 * plain.r);
    const flipped = new Uint32Array(rows * columns);
    for (let row = 0; row < rows; row++) flipped.set(pixels.subarray(row * columns, (row + 1) * columns), (rows - 1 - row) * columns);
    if (this.bare) flipped.fill(bare);
    else if (!header.diverging) flipped.forEach((one, at) => (flipped[at] = one || bare));
    else this.toRim(flipped, columns, rows);
    this.texture?.dispose();
    this.texture = new DataTexture(new Uint8Array(flipped.buffer), columns, rows, RGBAFormat, UnsignedByteType);
    Object.assign(this.texture, { colorSpace: SRGBColorSpace, minFilter: LinearFilter, magFilter: LinearFilter, needsUpdate: true });
    this.face.material.map = this.texture;
    this.face.material.needsUpdate = true;
    this.wall.material.color = plain;
    this.drawColours();
  }

  /** Pixels just outside the edge take the colour of their neighbours, so that no seam is visible. */
  toRim(pixels, columns, rows) {
    for (let pass = 0; pass < 2; pass++) {
      const before = pixels.slice();
      for (let row = 1; row < rows - 1; row++) {
        for (let at = row * columns + 1; at < (row + 1) * columns - 1; at++) {
          if (!before[at]) pixels[at] = before[at - 1] || before[at + 1] || before[at - columns] || before[at + columns];
        }
      }
    }
  }

  drawColours() {
    if (!this.surface) return;
    this.bar.hidden = Boolean(this.bare);
    if (this.bare) return;
    const { header, low, high, unit, label } = this.shown();
    drawBar(this.bar, { low, high, unit, label, name: tableOf(header.diverging, state.theme), clipped: header.p1 !== undefined });
  }

  tellNote() {
    const parts = [];
    if (this.wrong || this.bare) parts.push(this.wrong || this.bare);
    else if (this.surface) {
      if (this.source() === state.made) parts.push("job of the run");
      parts.push(this.scale === 1 ? "heights to scale" : `heights × ${this.scale.toLocaleString("en")}`);
      if (this.toolTimes > 1.05) parts.push(`tool × ${number(this.toolTimes, 2)}`);
      const { note } = this.shown().header;
      if (note) parts.push(note);
      if (this.coming) parts.push("loading the path");
      else if (this.path) parts.push(this.path.header.note);
    }
    this.note.textContent = parts.join("  ·  ");
    this.note.title = this.note.textContent;
    this.note.classList.toggle("bad", Boolean(this.wrong));
    this.note.classList.toggle("notice", Boolean(this.bare));
  }

  // ---------------------------------------------------------------------------------------------------------- axes

  label(text, colour, pixels = 15) {
    const canvas = document.createElement("canvas");
    const context = canvas.getContext("2d");
    const font = `600 36px ${inks().font}`;
    context.font = font;
    canvas.width = Math.ceil(context.measureText(text).width) + 12;
    canvas.height = 46;
    Object.assign(context, { font, fillStyle: colour, textBaseline: "middle" });
    context.fillText(text, 6, 24);
    const texture = new CanvasTexture(canvas);
    texture.colorSpace = SRGBColorSpace;
    const sprite = new Sprite(new SpriteMaterial({ map: texture, transparent: true, alphaTest: 0.05 }));
    Object.assign(sprite.userData, { pixels, aspect: canvas.width / canvas.height });
    return sprite;
  }

  /** x, y and z with ticks in mm around the part, z with its own scale. */
  makeAxes() {
    for (const one of this.axes.children) {
      one.geometry?.dispose();
      one.material.map?.dispose();
      one.material.dispose();
    }
    this.axes.clear();
    const { radius, z_low: low, z_high: high } = this.surface.header;
    const { ink, quiet } = inks();
    const ground = this.floor;
    const lines = [];
    const reach = radius * 1.09;
    const arrow = (from, to, head) => {
      lines.push(...from, ...to);
      for (const one of head) lines.push(...to, ...one);
    };
    const h = radius * 0.035;
    arrow([0, -reach, ground], [reach, -reach, ground], [[reach - h, -reach + h / 2, ground], [reach - h, -reach - h / 2, ground]]);
    arrow([-reach, 0, ground], [-reach, reach, ground], [[-reach + h / 2, reach - h, ground], [-reach - h / 2, reach - h, ground]]);
    lines.push(-reach, -reach, ground, reach, -reach, ground, -reach, -reach, ground, -reach, reach, ground);
    const marks = ticks(-radius, radius, 4);
    const add = (text, x, y, z, colour, pixels) => {
      const sprite = this.label(text, colour, pixels);
      sprite.position.set(x, y, z);
      this.axes.add(sprite);
    };
    const tick = radius * 0.025;
    for (const mark of marks) {
      lines.push(mark, -reach, ground, mark, -reach - tick, ground, -reach, mark, ground, -reach - tick, mark, ground);
      if (Math.abs(mark) > 0.86 * radius) continue;
      add(tickText(mark, marks), mark, -reach - 3.4 * tick, ground, quiet, 14);
      add(tickText(mark, marks), -reach - 3.4 * tick, mark, ground, quiet, 14);
    }
    add("x  mm", reach + 3.2 * tick, -reach, ground, ink, 16);
    add("y  mm", -reach, reach + 3.2 * tick, ground, ink, 16);
    const tall = scaleOf("mm", high - low);
    const heights = ticks(low * tall.factor, high * tall.factor, 3);
    const [zx, zy] = [-reach, -reach];
    const top = (this.top = Math.max(this.up(high), this.up(low) + 0.12 * radius) + 0.1 * radius);
    arrow([zx, zy, ground], [zx, zy, top], [[zx + h / 2, zy, top - h], [zx - h / 2, zy, top - h]]);
    for (const mark of heights) {
      const z = this.up(mark / tall.factor);
      if (z < ground || z > top) continue;
      lines.push(zx, zy, z, zx - tick, zy - tick * 0.3, z);
      add(tickText(mark, heights), zx - 4.4 * tick, zy, z, quiet, 14);
    }
    add(`z  ${tall.unit}`, zx, zy, top + 0.055 * radius, ink, 16);
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(lines), 3));
    this.axes.add(new LineSegments(geometry, new LineBasicMaterial({ color: new Color(inks().edge) })));
  }

  // ------------------------------------------------------------------------------------------------- path and tool

  async askPath() {
    const job = this.source();
    if (!job) return;
    this.following?.abort();
    const mine = (this.following = new AbortController());
    const slow = setTimeout(() => {
      this.coming = true;
      this.tellNote();
    }, 800);
    mine.signal.addEventListener("abort", () => clearTimeout(slow));
    try {
      const path = await postPacked("/view/path", { data: job, points: POINTS, client: CLIENT }, { signal: mine.signal });
      if (mine.signal.aborted) return;
      this.setPath({ ...path, job });
    } catch (error) {
      if (ignored(error) || mine !== this.following) return;
      this.setPath(null);
    }
    clearTimeout(slow);
  }

  setPath(path) {
    this.coming = false;
    this.path = path;
    // At its first point the tool is in the air, clear of the part.
    if (path && state.place === 0) set({ place: 0.42 });
    this.makePath();
    this.placeTool();
    this.tellNote();
    this.draw();
  }

  makePath() {
    if (this.spiral) {
      this.part.remove(this.spiral);
      this.spiral.geometry.dispose();
      this.spiral.material.dispose();
      this.spiral = null;
    }
    if (!this.path || !this.surface) return;
    const { header, arrays } = this.path;
    const contact = arrays.contact.data;
    const places = new Float32Array(contact.length);
    for (let at = 0; at < contact.length; at += 3) {
      places[at] = contact[at];
      places[at + 1] = contact[at + 1];
      places[at + 2] = this.up(contact[at + 2]);
    }
    const index = [];
    for (let turn = 0; turn + 1 < header.starts.length; turn++) {
      for (let at = header.starts[turn]; at + 1 < header.starts[turn + 1]; at++) index.push(at, at + 1);
    }
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(places, 3));
    geometry.setIndex(index);
    this.spiral = new LineSegments(geometry, new LineBasicMaterial({ color: new Color(state.theme === "dark" ? "#0b1216" : "#ffffff"), transparent: true, opacity: state.theme === "dark" ? 0.5 : 0.42 }));
    this.spiral.visible = this.visible.path;
    this.part.add(this.spiral);
  }

  /** Index of the drawn point nearest to the slider position. */
  index() {
    const fraction = this.path.arrays.fraction.data;
    let [low, high] = [0, fraction.length - 1];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (fraction[middle] < state.place) low = middle;
      else high = middle;
    }
    return state.place - fraction[low] < fraction[high] - state.place ? low : high;
  }

  /** The insert in the plane of its cutting edge: nose, flanks and a body relieved at the clearance angle. */
  makeTool() {
    this.part.remove(this.tool);
    const { nose_radius: nose, included, radius, clearance } = this.path.header;
    // A very small nose is drawn enlarged, with a note.
    const drawn = Math.max(nose, 0.035 * radius);
    this.toolTimes = drawn / nose;
    const half = Math.min((included ?? Math.PI) / 2, 1.5);
    const shape = new Shape();
    const steps = 24;
    for (let step = 0; step <= steps; step++) {
      const sweep = -half + (2 * half * step) / steps;
      const [u, e] = [drawn * Math.sin(sweep), drawn * (1 - Math.cos(sweep))];
      if (step) shape.lineTo(u, e);
      else shape.moveTo(u, e);
    }
    const edge = drawn * (1 - Math.cos(half));
    const tall = edge + 0.2 * radius;
    const flank = Math.min((0.5 * (tall - edge)) / Math.tan(Math.max(half, 0.12)), 0.6 * drawn + 0.05 * radius);
    const end = drawn * Math.sin(half) + flank;
    const bend = edge + flank * Math.tan(half);
    const high = Math.min(bend, tall);
    shape.lineTo(end, high);
    shape.lineTo(end, tall + 0.02 * radius);
    shape.lineTo(-end, tall + 0.02 * radius);
    shape.lineTo(-end, high);
    shape.closePath();
    const depth = Math.max(0.4 * drawn, 0.08 * radius);
    const geometry = new ExtrudeGeometry(shape, { depth, bevelEnabled: false, steps: 1 });
    // Shape and depth (u, e, back) become x radial, z up, y back along the cut; the heel rises at the clearance angle.
    const position = geometry.getAttribute("position");
    const rise = Math.tan(clearance ?? 0.1);
    for (let at = 0; at < position.count; at++) {
      const [u, e, back] = [position.getX(at), position.getY(at), position.getZ(at)];
      position.setXYZ(at, u, -back, e < tall * 0.8 ? e + back * rise : e);
    }
    geometry.computeVertexNormals();
    const diamond = new MeshStandardMaterial({ color: 0xd9a441, roughness: 0.35, metalness: 0.15, transparent: true, opacity: 0.88, side: DoubleSide, flatShading: true });
    this.tool = new Group();
    this.tool.add(new Mesh(geometry, diamond));
    this.tool.visible = this.visible.tool;
    this.part.add(this.tool);
    this.toolKey = JSON.stringify([nose, included, radius, clearance]);
  }

  placeTool() {
    const there = Boolean(this.path && this.surface);
    this.scrub.hidden = !there;
    if (this.tool) this.tool.visible = there && this.visible.tool;
    const hidden = !there || !this.visible.inset;
    if (hidden !== this.insetbox.hidden) {
      this.insetbox.hidden = hidden;
      if (this.surface && !this.moved) this.look(this.from ?? "iso");
    }
    if (!there) return;
    const { nose_radius: nose, included, radius, clearance, sense, turns } = this.path.header;
    if (this.toolKey !== JSON.stringify([nose, included, radius, clearance])) {
      this.makeTool();
      this.tellNote();
    }
    const { arrays } = this.path;
    const at = this.index();
    const [x, y, z] = arrays.position.data.subarray(3 * at, 3 * at + 3);
    const [cx, cy, cz] = arrays.contact.data.subarray(3 * at, 3 * at + 3);
    const angle = arrays.angle.data[at];
    // An enlarged nose keeps the contact point and the slope there.
    const sweep = arrays.sweep.data[at];
    const grown = this.toolTimes * nose;
    if (this.scale === 1 && this.toolTimes < 1.05) this.tool.position.set(x, y, this.up(z));
    else {
      const slope = Math.atan(Math.tan(sweep) * this.scale);
      const held = Math.max(-(included ?? Math.PI) / 2, Math.min((included ?? Math.PI) / 2, slope));
      const u = grown * Math.sin(held);
      this.tool.position.set(cx - u * Math.cos(angle), cy - u * Math.sin(angle), this.up(cz) - grown * (1 - Math.cos(held)));
    }
    this.tool.rotation.z = angle;
    this.tool.scale.y = sense;
    const fraction = arrays.fraction.data[at];
    this.slider.value = String(state.place);
    this.slider.setAttribute("aria-valuetext", `turn ${number(fraction * turns, 4)} of ${number(turns, 4)}`);
    this.where.textContent = `turn ${number(fraction * turns, 5)} of ${number(turns, 5)}   r ${arrays.radius.data[at].toFixed(3)} mm   ${degrees(angle)}   sweep ${((sweep * 180) / Math.PI).toFixed(2)}°`.replaceAll("-", "−");
    this.askSection(at);
    this.draw();
  }

  // --------------------------------------------------------------------------------------------------------- inset

  askSection(at) {
    clearTimeout(this.sectionTimer);
    if (!this.visible.inset) return;
    this.sectionTimer = setTimeout(async () => {
      this.cutting?.abort();
      // The path may have changed in the meantime.
      if (!this.path || at >= this.path.arrays.angle.data.length) return;
      const mine = (this.cutting = new AbortController());
      const { arrays, header, job } = this.path;
      const place = { angle: arrays.angle.data[at], radius: arrays.radius.data[at], y: arrays.y.data[at], feed: header.feed };
      try {
        const section = await postPacked("/view/section", { data: job, at: place, client: CLIENT }, { signal: mine.signal });
        if (mine.signal.aborted) return;
        this.section = section;
        this.drawInset();
      } catch (error) {
        if (ignored(error) || mine !== this.cutting) return;
        this.section = null;
        this.drawInset();
      }
    }, 40);
  }

  drawInset() {
    if (this.insetbox.hidden) return;
    const { context, width, height } = fitted(this.inset);
    context.clearRect(0, 0, width, height);
    if (width < 40 || !this.section) return;
    const colours = inks();
    if (height < 230) {
      // In a low scene both are placed side by side.
      const half = Math.round(width * 0.48);
      this.drawTrue(context, colours, { left: 8, top: 20, width: half - 16, height: height - 28 });
      this.drawClose(context, colours, { left: half + 38, top: 20, width: width - half - 48, height: height - 42, title: half });
      return;
    }
    const split = Math.round(height * 0.5);
    this.drawTrue(context, colours, { left: 8, top: 20, width: width - 16, height: split - 26 });
    this.drawClose(context, colours, { left: 44, top: split + 18, width: width - 54, height: height - split - 42, title: 8 });
  }

  /** Part and nose, to scale. */
  drawTrue(context, colours, box) {
    const { header, arrays } = this.section;
    const { contact, tip, nose_radius: nose } = header;
    // As wide as the nose, but narrow enough to show the contact.
    const wide = Math.min(2.3 * nose, 2.3 * Math.abs(arrays.edge.data[0] - tip.radius));
    const scale = box.width / wide;
    const toScreen = (u, z) => [box.left + box.width / 2 + (u - tip.radius) * scale, box.top + box.height * 0.72 - (z - contact.z) * scale];
    context.save();
    context.beginPath();
    context.rect(box.left, box.top, box.width, box.height);
    context.clip();
    const trace = (pairs) => {
      context.beginPath();
      let begun = false;
      for (let at = 0; at < pairs.length; at += 2) {
        if (Number.isNaN(pairs[at + 1])) continue;
        const [x, y] = toScreen(pairs[at], pairs[at + 1]);
        if (begun) context.lineTo(x, y);
        else context.moveTo(x, y);
        begun = true;
      }
    };
    trace(arrays.surface.data);
    context.strokeStyle = colours.accent;
    context.lineWidth = 1.6;
    context.stroke();
    const ends = [...arrays.surface.data].filter((one, at) => at % 2 === 0 && !Number.isNaN(arrays.surface.data[at + 1]));
    if (ends.length) {
      context.lineTo(toScreen(ends.at(-1), 0)[0], box.top + box.height);
      context.lineTo(toScreen(ends[0], 0)[0], box.top + box.height);
    }
    context.fillStyle = `${colours.accent}26`;
    context.fill();
    trace(arrays.edge.data);
    context.fillStyle = "#d9a44166";
    context.fill();
    trace(arrays.edge.data);
    context.strokeStyle = state.theme === "dark" ? "#f0c56b" : "#8a5a00";
    context.lineWidth = 1.8;
    context.stroke();
    const [x, y] = toScreen(contact.u, contact.z);
    context.fillStyle = colours.bad;
    context.beginPath();
    context.arc(x, y, 3, 0, 7);
    context.fill();
    context.restore();
    Object.assign(context, { font: `11px ${colours.font}`, fillStyle: colours.ink, textBaseline: "alphabetic", textAlign: "left" });
    const bar = round(wide / 3.5);
    // The longest title that fits.
    const room = box.width - context.measureText(length(bar, 2)).width - 8;
    const title = ["Edge in contact, to scale", "Edge, to scale", "To scale", ""].find((one) => context.measureText(one).width <= room);
    context.fillText(title, box.left, 13);
    context.fillStyle = colours.quiet;
    context.textAlign = "right";
    const right = box.left + box.width;
    context.fillText(length(bar, 2), right, 13);
    context.fillRect(right - bar * scale, box.top - 3, bar * scale, 2);
  }

  /** The cusps near the contact, heights in nanometres above the nominal surface. */
  drawClose(context, colours, box) {
    const { header, arrays } = this.section;
    const near = arrays.near.data;
    const span = near.at(-1);
    const feed = header.feed;
    const shown = Math.min(span, 2.6 * feed);
    const cusp = Math.max((1.2 * feed * feed) / (8 * header.nose_radius), 1e-7);
    const high = Math.max(cusp * 3.2, 4e-7);
    const low = -high * 0.3;
    const up = scaleOf("mm", high);
    const toScreen = (u, gap) => [box.left + box.width / 2 + (u / shown) * (box.width / 2), box.top + box.height - ((gap - low) / (high - low)) * box.height];
    const trace = (values, from = 0) => {
      context.beginPath();
      let begun = false;
      for (let at = 0; at < near.length; at++) {
        const gap = values[from + at];
        if (Number.isNaN(gap) || Math.abs(near[at]) > shown * 1.02) {
          continue;
        }
        const point = toScreen(near[at], Math.min(gap, high * 3));
        if (begun) context.lineTo(...point);
        else context.moveTo(...point);
        begun = true;
      }
    };
    Object.assign(context, { font: `11px ${colours.font}`, fillStyle: colours.ink, textBaseline: "alphabetic", textAlign: "left" });
    context.fillText(box.width > 170 ? "Cusps at the contact" : "Cusps", box.title, box.top - 6);
    context.textAlign = "right";
    context.fillStyle = colours.quiet;
    context.fillText(`${header.varies ? "mean feed" : "feed"} ${length(feed)}`, box.left + box.width, box.top - 6);
    context.save();
    context.beginPath();
    context.rect(box.left, box.top, box.width, box.height);
    context.fillStyle = colours.sunken;
    context.fill();
    context.clip();
    if (Number.isNaN(arrays.edge_gap.data[near.length >> 1])) {
      Object.assign(context, { fillStyle: colours.quiet, textAlign: "center" });
      context.fillText("outside the clear aperture", box.left + box.width / 2, box.top + box.height / 2);
      context.restore();
      return;
    }
    trace(arrays.left_gap.data);
    context.lineTo(...toScreen(shown, low));
    context.lineTo(...toScreen(-shown, low));
    context.closePath();
    context.fillStyle = `${colours.accent}40`;
    context.fill();
    trace(arrays.left_gap.data);
    Object.assign(context, { strokeStyle: colours.accent, lineWidth: 1.4 });
    context.stroke();
    trace(arrays.edge_gap.data);
    Object.assign(context, { strokeStyle: state.theme === "dark" ? "#f0c56b" : "#8a5a00", lineWidth: 2 });
    context.stroke();
    context.setLineDash([4, 3]);
    Object.assign(context, { strokeStyle: colours.quiet, lineWidth: 1 });
    context.beginPath();
    context.moveTo(...toScreen(-shown, 0));
    context.lineTo(...toScreen(shown, 0));
    context.stroke();
    context.restore();
    Object.assign(context, { strokeStyle: colours.line, lineWidth: 1, font: `10px ${colours.font}`, fillStyle: colours.quiet, textAlign: "right", textBaseline: "middle" });
    context.strokeRect(box.left - 0.5, box.top - 0.5, box.width + 1, box.height + 1);
    const marks = ticks(0, high * up.factor, 3);
    for (const mark of marks) {
      const [, y] = toScreen(0, mark / up.factor);
      if (y > box.top + 6) context.fillText(tickText(mark, marks), box.left - 5, y);
    }
    context.fillText(up.unit, box.left - 5, box.top + 2);
    const across = scaleOf("mm", shown);
    const sides = ticks(-shown * across.factor, shown * across.factor, 4);
    Object.assign(context, { textAlign: "center", textBaseline: "top" });
    for (const mark of sides) {
      const [x] = toScreen(mark / across.factor, 0);
      if (x < box.left + box.width - 24) context.fillText(tickText(mark, sides), x, box.top + box.height + 4);
    }
    context.textAlign = "right";
    context.fillText(across.unit, box.left + box.width + 4, box.top + box.height + 4);
  }

  // ------------------------------------------------------------------------------------------------ what is heard

  flip(name, value) {
    this.visible[name] = value;
    if (name === "inset") {
      this.insetbox.hidden = !value || !this.path;
      if (this.moved) this.frame();
      else this.look(this.from ?? "iso");
    }
    if (name === "path" && this.spiral) this.spiral.visible = value;
    this.placeTool();
    this.draw();
  }

  /** The point on the part under the pointer. */
  hit(event) {
    const box = this.canvas.getBoundingClientRect();
    const at = new Vector2(((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2);
    this.ray.setFromCamera(at, this.camera);
    const [found] = this.ray.intersectObject(this.face);
    return found ? [found.point.x, found.point.y] : null;
  }

  point([x, y]) {
    const { of, unit } = this.shown();
    const { header, arrays } = of;
    const [rows, columns] = arrays.values.shape;
    const column = Math.round(((x - header.x[0]) / (header.x[1] - header.x[0])) * (columns - 1));
    const row = Math.round(((y - header.y[0]) / (header.y[1] - header.y[0])) * (rows - 1));
    const value = arrays.values.data[row * columns + column];
    this.readout.textContent = `x ${x.toFixed(3)} mm, y ${y.toFixed(3)} mm   ${formatted(value, unit, 4)}`.replaceAll("-", "−");
  }

  showCursor(cursor) {
    if (this.ring) this.ring.visible = Boolean(cursor && this.surface);
    if (!cursor || !this.surface) return this.draw();
    const { radius } = this.surface.header;
    if (!this.ring) {
      this.ring = new Mesh(new RingGeometry(0.8, 1, 40), new MeshBasicMaterial({ color: 0xd8402a, depthTest: false, side: DoubleSide, transparent: true }));
      this.ring.renderOrder = 5;
      this.part.add(this.ring);
    }
    this.ring.scale.setScalar(0.022 * radius);
    this.ring.position.set(cursor[0], cursor[1], this.up(this.heightAt(...cursor)) + 0.002 * radius);
    return this.draw();
  }

  listen() {
    const soon = framed(() => {
      if (!this.last || !this.surface) return;
      const place = this.hit(this.last);
      if (place) this.point(place);
      else this.readout.textContent = "";
      this.own = place;
      set({ cursor: place });
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) return;
      this.last = event;
      soon();
    });
    this.canvas.addEventListener("pointerleave", () => {
      this.last = null;
      this.readout.textContent = "";
      set({ cursor: null });
    });
    this.controls.addEventListener("start", () => (this.moved = true));
    this.canvas.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const turn = (across, up) => this.turn(across, up);
      const move = (dx, dy) => this.shift(dx, dy);
      const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      const act = way
        ? () => (event.shiftKey ? move(way[0] * 0.1, way[1] * 0.1) : turn(way[0] * 0.12, way[1] * 0.09))
        : { "+": () => this.near(0.85), "=": () => this.near(0.85), "-": () => this.near(1 / 0.85), Home: () => this.show("iso"), ",": () => this.step(-1), ".": () => this.step(1) }[event.key];
      if (!act || !this.surface) return;
      event.preventDefault();
      event.stopPropagation();
      this.moved = true;
      act();
    });
    this.slider.addEventListener("input", () => set({ place: Number(this.slider.value) }));
    this.slider.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -84, PageUp: 84 }[event.key];
      if (!by) return;
      event.preventDefault();
      this.step(by);
    });
    const look = (_, keys) => {
      const { errors, check, checking } = state;
      const job = this.source();
      if (!job) return;
      // An invalid job cannot be drawn: the scene is updated after a check. A job that is opened as a whole was validated
      // before, and so was that of a run; whether a path can be laid is known afterwards.
      const judged = job === state.made || !checking;
      const read = job === state.made || (errors.length === 0 ? judged || (keys.has("job") && keys.has("errors")) : judged && check?.errors === errors);
      if (job !== this.looked && read) {
        this.looked = job;
        this.askSurface();
      }
      if (job === this.followed || !judged) return;
      this.followed = job;
      if (job === state.made || errors.length === 0) this.askPath();
      else {
        this.following?.abort();
        this.setPath(null);
      }
    };
    this.unheard = [
      on(["job", "errors", "check", "checking"], look, { now: true }),
      on("quantity", ({ quantity }) => {
        this.choose.value = quantity;
        if (this.source() !== this.looked) look(state, new Set());
        else this.askSurface();
      }),
      on(["run", "maps", "result", "made"], ({ quantity }) => {
        if (!FOUND[quantity]) return;
        if (this.source() !== this.looked) look(state, new Set());
        else this.askSurface();
      }),
      on("place", () => this.placeTool()),
      on("cursor", ({ cursor }) => this.showCursor(cursor)),
      on("theme", () => requestAnimationFrame(() => {
        if (!this.surface) return;
        this.colourPart();
        this.makeAxes();
        this.makePath();
        this.drawInset();
        this.draw();
      })),
    ];
    this.choose.value = state.quantity;
  }

  step(by) {
    if (!this.path) return;
    const fraction = this.path.arrays.fraction.data;
    const at = Math.max(0, Math.min(fraction.length - 1, this.index() + by));
    set({ place: fraction[at] });
  }

  turn(across, up) {
    const from = this.camera.position.clone().sub(this.controls.target);
    const away = from.length();
    const azimuth = Math.atan2(from.y, from.x) + across;
    const height = Math.max(0.01, Math.min(1.5707, Math.asin(from.z / away) + up));
    this.camera.position.set(away * Math.cos(height) * Math.cos(azimuth), away * Math.cos(height) * Math.sin(azimuth), away * Math.sin(height)).add(this.controls.target);
    this.controls.update();
    this.draw();
  }

  shift(dx, dy) {
    const right = new Vector3().setFromMatrixColumn(this.camera.matrix, 0);
    const above = new Vector3().setFromMatrixColumn(this.camera.matrix, 1);
    const by = right.multiplyScalar(dx).add(above.multiplyScalar(dy)).multiplyScalar(this.surface.header.radius);
    this.camera.position.add(by);
    this.controls.target.add(by);
    this.controls.update();
    this.draw();
  }

  near(factor) {
    const from = this.camera.position.clone().sub(this.controls.target).multiplyScalar(factor);
    this.camera.position.copy(from.add(this.controls.target));
    this.controls.update();
    this.draw();
  }

  destroy() {
    this.unheard.forEach((stop) => stop());
    this.sized.disconnect();
    this.asking?.abort();
    this.following?.abort();
    this.controls.dispose();
    this.renderer.dispose();
    this.box.replaceChildren();
  }
}

/** Show the scene in a box. */
export function mount(box) {
  try {
    const view = new View(box);
    return { destroy: () => view.destroy() };
  } catch (error) {
    console.info(error);
    box.classList.remove("scenebox");
    box.replaceChildren(element("div", { class: "teach" }, [
      element("h3", {}, ["The part cannot be drawn here"]),
      element("p", {}, ["This browser has no 3-D graphics (WebGL): enable hardware acceleration, or use another browser."]),
      element("p", {}, ["Fields, verdict, runs, maps, profiles and programs work without it."]),
    ]));
    return { destroy: () => box.replaceChildren() };
  }
}
