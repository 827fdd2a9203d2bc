/* The text of the program, of any length: only visible lines are loaded and drawn. */

import { html, render, useEffect, useLayoutEffect, useRef, useState } from "./vendor/preact.js";
import { get } from "./api.js";
import { on, say, set, state } from "./state.js";
import { Downloads, count, number, useStore } from "./ui.js";

const ROW = 18; // px of a line
const CHUNK = 500; // lines per request
const MAX_CHUNKS = 60; // in memory
const MAX_HEIGHT = 4_000_000; // px; browsers allow some ten million

let chunks = new Map(); // first line -> chunk
let asked = new Map(); // first line -> pending request
let run = null;

/** A promise of the chunk of a line; null if it cannot be loaded. */
function chunkOf(line) {
  const first = line - (line % CHUNK);
  if (chunks.has(first)) return Promise.resolve(chunks.get(first));
  if (!asked.has(first)) asked.set(first, fetchChunk(first, run));
  return asked.get(first);
}

async function fetchChunk(first, mine) {
  try {
    const answer = await get(`/runs/${mine}/program`, { first, count: CHUNK });
    if (mine !== run) return null;
    chunks.set(first, answer);
    if (chunks.size > MAX_CHUNKS) chunks.delete(chunks.keys().next().value);
    return answer;
  } catch (error) {
    say(error.message, "bad");
    return null;
  } finally {
    if (mine === run) asked.delete(first);
  }
}

function lineAt(line) {
  const chunk = chunks.get(line - (line % CHUNK));
  return chunk ? { text: chunk.lines[line % CHUNK], place: chunk.places[line % CHUNK] } : null;
}

/** A line with its words highlighted by kind. */
function Words({ text }) {
  const comment = text.search(/[(;]/);
  const [code, rest] = comment < 0 ? [text, ""] : [text.slice(0, comment), text.slice(comment)];
  return html`${code.split(/(?<=\s)/).map((word) => html`<span class=${/^[GM]\d/.test(word) ? "code" : /^N\d/.test(word) ? "label" : ""}>${word}</span>`)}${rest && html`<span class="remark">${rest}</span>`}`;
}

function Text({ total }) {
  const box = useRef(null);
  const [first, goTo] = useState(0);
  const [rows, setRows] = useState(20);
  const [, again] = useState(0);
  const { block } = useStore(["block"]);
  const own = useRef(false);
  const tall = Math.min(total * ROW, MAX_HEIGHT);
  const last = Math.max(0, total - rows);

  useLayoutEffect(() => {
    const size = new ResizeObserver(() => setRows(Math.max(1, Math.floor(box.current.clientHeight / ROW))));
    size.observe(box.current);
    return () => size.disconnect();
  }, []);
  useEffect(() => {
    for (let at = first - (first % CHUNK); at < Math.min(total, first + rows + CHUNK / 5); at += CHUNK) {
      if (!chunks.has(at)) chunkOf(at).then(() => again((times) => times + 1));
    }
  }, [first, rows, total]);

  const move = (line) => {
    const next = Math.max(0, Math.min(last, Math.round(line)));
    goTo(next);
    // Ignore the scroll event that this causes.
    own.current = true;
    box.current.scrollTop = last ? (next / last) * (tall - box.current.clientHeight) : 0;
  };
  const scrolled = () => {
    if (own.current) return (own.current = false);
    return goTo(Math.round((box.current.scrollTop / Math.max(1, tall - box.current.clientHeight)) * last));
  };
  useEffect(() => {
    if (block !== null && (block < first || block >= first + rows)) move(block - rows / 2);
  }, [block]);
  const point = (line) => set({ block: line });
  const keys = (event) => {
    const here = block ?? first;
    const to = { ArrowDown: here + 1, ArrowUp: here - 1, PageDown: here + rows, PageUp: here - rows, Home: 0, End: total - 1 }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    point(Math.max(0, Math.min(total - 1, to)));
  };
  const wheel = (event) => {
    event.preventDefault();
    move(first + Math.sign(event.deltaY) * Math.max(1, Math.round(Math.abs(event.deltaY) / ROW)));
  };
  useEffect(() => {
    const element = box.current;
    element.addEventListener("wheel", wheel, { passive: false });
    return () => element.removeEventListener("wheel", wheel);
  });
  useLayoutEffect(() => {
    box.current.querySelector(".spacer").style.height = `${tall}px`;
  }, [tall]);
  const shown = Array.from({ length: Math.min(rows + 1, total - first) }, (_, index) => first + index);
  return html`<div class="program" ref=${box} tabindex="0" role="listbox" aria-label="Lines of the program" aria-activedescendant=${block === null ? null : `line-${block}`} onScroll=${scrolled} onKeyDown=${keys}>
    <div class="spacer"><div class="lines">${shown.map((line) => {
      const found = lineAt(line);
      return html`<div key=${line} id=${`line-${line}`} role="option" aria-selected=${line === block ? "true" : "false"} onClick=${() => point(line)}><span class="at">${line + 1}</span><code>${found ? html`<${Words} text=${found.text} />` : "…"}</code></div>`;
    })}</div></div>
  </div>`;
}

function Panel() {
  const { run: id, result, block, runs, files } = useStore(["run", "result", "block", "runs", "files"]);
  const [total, setTotal] = useState(0);
  const [follow, setFollow] = useState(false);
  const [place, setPlace] = useState(null);
  const own = useRef(null);
  const kind = runs.find((one) => one.id === id)?.kind;
  useEffect(() => {
    run = id;
    chunks = new Map();
    asked = new Map();
    setTotal(0);
    setPlace(null);
    if (id && result) chunkOf(0).then((chunk) => chunk && setTotal(chunk.total));
  }, [id, result]);
  useEffect(() => {
    // Show the tip position of the line on the part once it is loaded.
    setPlace(null);
    if (block === null || !result) return;
    chunkOf(block).then(() => {
      const found = lineAt(block)?.place;
      if (!found || state.block !== block) return;
      setPlace(found);
      own.current = [found[0], found[1]];
      set({ cursor: own.current });
    });
  }, [block, result]);
  useEffect(() => {
    if (!follow || !result) return undefined;
    let timer = 0;
    const stop = on("cursor", ({ cursor }) => {
      clearTimeout(timer);
      // Ignore the cursor that a chosen line has set.
      if (!cursor || cursor === own.current) return;
      timer = setTimeout(async () => {
        try {
          const { line } = await get(`/runs/${run}/program`, { near: cursor.join(",") });
          if (Number.isInteger(line)) set({ block: line });
        } catch (error) {
          say(error.message, "bad");
        }
      }, 120);
    });
    return () => {
      clearTimeout(timer);
      stop();
    };
  }, [follow, id, result]);
  if (!id || !result || kind === "compare") {
    return html`<div class="teach"><h3>The program, line by line</h3><p>The program of a finished run is shown here. Click a line to mark its point on the part; point at the part to find its line.</p></div>`;
  }
  return html`<div class="programs">
    <div class="bar">
      <label>Go to line <input type="text" inputmode="numeric" class="short" aria-label="Go to line" disabled=${total === 0} onChange=${(event) => {
        const line = Number(event.target.value.replace(/\D/g, "")) - 1;
        if (line >= 0) set({ block: Math.min(total - 1, line) });
      }} /></label>
      <span class="quiet">of ${count(total)}</span>
      <label class="flag"><input type="checkbox" checked=${follow} onChange=${(event) => setFollow(event.target.checked)} />follow the pointer on the part</label>
      <span class="gap"></span>
      ${place && html`<span class="number" title="Tip position after the line, in the part frame">x ${number(place[0], 5)}, y ${number(place[1], 5)}, z ${number(place[2], 5)} mm</span>`}
      <${Downloads} path=${`/runs/${id}`} files=${files} only=${["program", "table"]} />
    </div>
    ${total > 0 ? html`<${Text} key=${id} total=${total} />` : html`<p class="quiet pad">Reading the program …</p>`}
  </div>`;
}

export function mount(element) {
  render(html`<${Panel} />`, element);
  return { destroy: () => render(null, element) };
}
