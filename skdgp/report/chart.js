"use strict";
// Charts of samples against time: zoom, pan, read values. Charts of one link share the visible time and the cursor.

const BAND_ROOM = 0.6; // a band widens the vertical axis by at most this part of the lines' own range
const GAP = 5; // a step longer than this many usual ones breaks the lines
const LEFT = 46, RIGHT = 6, TOP = 4, HEIGHT = 118, AXIS = 30; // [px] of a panel
const FEWEST = 8; // samples that remain visible
const links = new Map(); // name -> {begin, end, low, high, cursor, charts, spans, tracks}

const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

// ---- samples ------------------------------------------------------------------------------------

async function unpack(spec) {
  const packed = Uint8Array.from(atob(spec.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  let at = 0;
  return spec.columns.map(([low, step, size]) => column(bytes.subarray(at, (at += spec.n * size)), spec.n, low, step));
}

// Differences of counts, all first bytes first; a count of 0 is a hole.
function column(bytes, n, low, step) {
  const values = new Float64Array(n), size = bytes.length / n;
  for (let i = 0, count = 0; i < n; i++) {
    for (let k = 0; k < size; k++) count += bytes[k * n + i] * 256 ** k;
    count %= 256 ** size;
    values[i] = count ? low + (count - 1) * step : NaN;
  }
  return values;
}

// Where a line must not come from the sample before.
function cuts(time, window) {
  const steps = Float64Array.from(time.subarray(1), (t, i) => t - time[i]).sort();
  const longest = GAP * steps[steps.length >> 1];
  return Uint8Array.from(time, (t, i) =>
    i === 0 || t - time[i - 1] > longest || (window !== null && window[i] !== window[i - 1]));
}

// The first index whose time is not before t.
function index(time, t) {
  let low = 0, high = time.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (time[middle] < t) low = middle + 1; else high = middle;
  }
  return low;
}

function nearest(time, t) {
  const after = Math.min(index(time, t), time.length - 1);
  return after > 0 && t - time[after - 1] < time[after] - t ? after - 1 : after;
}

// ---- numbers ------------------------------------------------------------------------------------

function ticks(low, high, most) {
  const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++)
    found.push([k * step, minus((k * step).toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1"))]);
  return found;
}

const minus = (words) => words.replace("-", "−");

function written(value, step) {
  if (Number.isNaN(value)) return "–";
  const digits = Math.min(8, Math.max(0, Math.ceil(2.5 - Math.log10(step || 1))));
  return minus(value.toFixed(digits));
}

// ---- drawing ----------------------------------------------------------------------------------------

// Fit the vertical axis to the lines; a band wider than that runs out of the picture.
function limits(shown) {
  const range = (some) => {
    const cells = some.flatMap((one) => one.strokes.flat());
    return [Math.min(...cells.map((cell) => cell.low)), Math.max(...cells.map((cell) => cell.high))];
  };
  const lines = shown.filter((one) => one.std === null), bands = shown.filter((one) => one.std !== null);
  let [low, high] = range(lines.length ? lines : bands);
  const room = BAND_ROOM * (high - low), [below, above] = range(bands);
  [low, high] = [Math.min(low, Math.max(low - room, below)), Math.max(high, Math.min(high + room, above))];
  if (!(low <= high)) [low, high] = [0, 1];
  const margin = 0.05 * (high - low) || Math.abs(high) * 1e-3 || 1;
  return [low - margin, high + margin];
}

function drawLine(pen, one, x, y) {
  pen.strokeStyle = color(one.color);
  pen.fillStyle = pen.strokeStyle;
  pen.lineWidth = one.width;
  pen.lineJoin = "round";
  pen.setLineDash(one.dashed && !one.wide ? [6, 3] : []);
  pen.beginPath();
  for (const stroke of one.strokes) {
    const [begin] = stroke;
    if (stroke.length === 1 && begin.low === begin.high) pen.fillRect(x(begin.t) - 1, y(begin.first) - 1, 2, 2);
    pen.moveTo(x(begin.t), y(begin.first));
    for (const { t, first, low, high, last } of stroke) {
      pen.lineTo(x(t), y(first));
      if (low === high) continue;
      pen.lineTo(x(t), y(low));
      pen.lineTo(x(t), y(high));
      pen.lineTo(x(t), y(last));
    }
  }
  pen.stroke();
  pen.setLineDash([]);
}

// Draw along one edge of a stroke's cells, "low" or "high".
function follow(pen, cells, edge, x, y, join = false) {
  cells.forEach((cell, k) => (k || join ? pen.lineTo(x(cell.t), y(cell[edge])) : pen.moveTo(x(cell.t), y(cell[edge]))));
}

function drawEdges(pen, one, x, y) {
  pen.strokeStyle = color(one.color);
  pen.lineWidth = 1.2;
  pen.beginPath();
  for (const stroke of one.strokes) for (const edge of ["high", "low"]) follow(pen, stroke, edge, x, y);
  pen.stroke();
}

function drawBand(pen, one, x, y) {
  pen.fillStyle = color(one.color);
  pen.globalAlpha = 0.45;
  pen.beginPath();
  for (const stroke of one.strokes) {
    follow(pen, stroke, "high", x, y);
    follow(pen, [...stroke].reverse(), "low", x, y, true);
    pen.closePath();
  }
  pen.fill();
  pen.globalAlpha = 1;
}

// ---- page ---------------------------------------------------------------------------------------

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

function button(label, title, act) {
  // A sign is not read out; words are, and must be what is seen (WCAG 2.1, label in name).
  const made = element("button", { type: "button", title, ...(label.length === 1 && { "aria-label": title }) }, label);
  made.addEventListener("click", act);
  return made;
}

// ---- chart --------------------------------------------------------------------------------------

class Chart {
  constructor(figure, spec, columns) {
    this.spec = spec;
    [this.time, ...this.columns] = columns;
    this.cut = cuts(this.time, spec.window === null ? null : this.columns[spec.window]);
    this.hidden = new Set();
    this.relative = false;
    this.link = this.join(spec.link);
    this.build(figure);
    this.listen();
  }

  join(name) {
    const low = this.time[0], high = this.time[this.time.length - 1];
    const link = links.get(name) ?? { begin: low, end: high, low, high, cursor: null, charts: [], spans: [], tracks: [] };
    link.low = Math.min(link.low, low);
    link.high = Math.max(link.high, high);
    [link.begin, link.end] = this.spec.spans[0] ?? (link.charts.length ? [link.begin, link.end] : [low, high]);
    link.charts.push(this);
    if (this.spec.spans.length) link.spans = this.spec.spans;
    links.set(name, link);
    return link;
  }

  build(figure) {
    const { spec, link } = this;
    const seconds = ([begin, end]) => `${minus(begin.toFixed(0))} to ${minus(end.toFixed(0))} s`;
    this.spans = [[link.low, link.high], ...link.spans].map((span, k) => {
      const made = button(k ? seconds(span) : "Whole flight", k ? "Show these seconds" : "Show the whole flight",
        () => this.show(...(k ? span : [link.low, link.high])));
      return { made, span, whole: k === 0 };
    });
    const middle = () => link.cursor ?? (link.begin + link.end) / 2;
    const steps = [
      button("−", "Zoom out", () => this.zoom(2, middle())),
      button("+", "Zoom in", () => this.zoom(0.5, middle())),
      button("‹", "Earlier", () => this.move(-0.25)),
      button("›", "Later", () => this.move(0.25)),
    ];
    this.clock = element("span", { class: "clock" });
    const names = new Map(spec.panels.flatMap((panel) => panel.series.map((one) => [one.name, one])));
    const toggles = [...names.values()].map((one) => this.seriesToggle(one));
    if (spec.panels.every((panel) => panel.base !== null)) toggles.push(this.differenceToggle());
    this.panels = spec.panels.map((panel) => this.panel(panel));
    this.thumb = element("div", { class: "thumb" });
    this.track = element("div", { class: "track", "aria-hidden": "true" }, this.thumb);
    this.grid = element("div", {
      class: spec.panels.length < 4 ? "grid one" : "grid", tabindex: "0", role: "group",
      "aria-label": `${spec.title}: interactive chart`, style: `--rows: ${Math.ceil(spec.panels.length / 2)}`,
    }, ...this.panels.map((panel) => panel.box));
    this.spoken = element("p", { class: "unseen", "aria-live": "polite" });
    this.live = element("div", { class: "live" },
      element("div", { class: "tools" }, element("div", { class: "spans" }, ...this.spans.map((one) => one.made)),
        element("div", { class: "steps" }, ...steps), this.clock));
    if (spec.panels.some((panel) => panel.series.length > 1))
      this.live.append(element("div", { class: "toggles", role: "group", "aria-label": "What is drawn" }, ...toggles));
    this.live.append(this.grid, this.track);
    if (figure === document.querySelector("figure.chart")) this.live.append(this.hint());
    this.live.append(this.spoken);
    figure.prepend(this.live);
    figure.classList.add("on");
  }

  hint() {
    const { every } = this.spec;
    return element("p", { class: "hint" }, matchMedia("(hover: none)").matches
      ? "Touch to read values, swipe sideways to move, pinch to zoom."
      : "Point to read values. Drag over the seconds to see closer, drag the bar or turn the wheel with Ctrl to move "
        + "on and zoom, double-click for the whole flight; keys: ← → + − 0.",
      every > 1 ? ` Of each ${2 * every} samples the lowest and the highest are kept.` : "");
  }

  // A button that stays pressed; act changes what is shown and returns whether it is pressed.
  toggle(attributes, act, ...label) {
    const made = element("button", { type: "button", ...attributes }, ...label);
    made.addEventListener("click", () => {
      made.setAttribute("aria-pressed", String(act()));
      this.stale();
    });
    return made;
  }

  seriesToggle(one) {
    const mark = element("i", { class: one.std === null ? "" : "area", style: `color: var(--${one.color})` });
    const flip = () => this.hidden.delete(one.name) || !this.hidden.add(one.name);
    return this.toggle({ "aria-pressed": "true" }, flip, mark, one.name);
  }

  // Shows the residuals: clearer on a long record.
  differenceToggle() {
    const attributes = { "aria-pressed": "false", class: "way", title: "Show everything relative to the estimate" };
    return this.toggle(attributes, () => (this.relative = !this.relative), "less estimate");
  }

  // The i-th value of a series as it is shown.
  at(panel, one, i) {
    return this.columns[one.values][i] - (this.relative ? this.columns[panel.base][i] : 0);
  }

  panel(panel) {
    const label = element("b");
    label.innerHTML = panel.label;
    const value = element("span", { class: "value" });
    const canvas = element("canvas", { role: "img", "aria-label": panel.title });
    const cursor = element("div", { class: "cursor", hidden: "" });
    const picked = element("div", { class: "picked", hidden: "" });
    const plot = element("div", { class: "plot" }, canvas, picked, cursor);
    const unit = panel.unit ? element("span", { class: "unit" }, `[${panel.unit}]`) : "";
    const box = element("div", { class: "panel" }, element("p", { class: "head" }, label, unit, value), plot);
    return { ...panel, box, plot, canvas, cursor, picked, value };
  }

  // ---- what is visible ----

  show(begin, end) {
    const { link } = this;
    const step = (this.time[this.time.length - 1] - this.time[0]) / (this.time.length - 1);
    const length = Math.min(Math.max(end - begin, FEWEST * step), link.high - link.low);
    begin = Math.min(Math.max((begin + end - length) / 2, link.low), link.high - length);
    [link.begin, link.end] = [begin, begin + length];
    for (const chart of link.charts) chart.stale();
  }

  zoom(factor, about) {
    const { begin, end } = this.link;
    this.show(about - (about - begin) * factor, about + (end - about) * factor);
  }

  move(part) {
    const { begin, end, low, high } = this.link;
    const by = Math.min(Math.max(part * (end - begin), low - begin), high - end);
    this.show(begin + by, end + by);
  }

  point(t) {
    this.link.cursor = t;
    for (const reader of [...this.link.charts, ...this.link.tracks]) reader.read();
  }

  stale() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.draw();
    });
  }

  // ---- drawing ----

  draw() {
    const { begin, end, low, high } = this.link;
    this.live.dataset.begin = begin;
    this.live.dataset.end = end;
    this.thumb.style.left = `${(100 * (begin - low)) / (high - low)}%`;
    this.thumb.style.width = `${(100 * (end - begin)) / (high - low)}%`;
    for (const { made, span, whole } of this.spans) {
      const [a, b] = whole ? [low, high] : span;
      made.setAttribute("aria-pressed", String(Math.abs(a - begin) + Math.abs(b - end) < 1e-6));
    }
    const width = this.panels[0].plot.clientWidth;
    if (!width) return;
    const colors = Object.fromEntries(["ink", "quiet", "rule"].map((name) => [name, color(name)]));
    const bottom = this.panels.map((panel, k) => this.isBottom(k));
    this.panels.forEach((panel, k) => this.drawPanel(panel, width, bottom[k] ? AXIS : 6, colors));
    this.read();
  }

  // Whether nothing stands below the panel in its column.
  isBottom(k) {
    const boxes = this.panels.map((panel) => panel.box.getBoundingClientRect());
    return !boxes.some((box) => box.top > boxes[k].top + 1 && Math.abs(box.left - boxes[k].left) < 1);
  }

  drawPanel(panel, width, axis, colors) {
    const { canvas } = panel, dense = window.devicePixelRatio || 1, height = TOP + HEIGHT + axis;
    canvas.style.height = `${height}px`;
    if (canvas.width !== Math.round(width * dense) || canvas.height !== Math.round(height * dense))
      [canvas.width, canvas.height] = [Math.round(width * dense), Math.round(height * dense)];
    const pen = canvas.getContext("2d");
    pen.setTransform(dense, 0, 0, dense, 0, 0);
    pen.clearRect(0, 0, width, height);
    const plot = Math.max(width - LEFT - RIGHT, 1);
    const shown = panel.series.filter((one) => !this.hidden.has(one.name)).map((one) => this.condense(panel, one, plot));
    const [low, high] = limits(shown);
    const x = (t) => LEFT + ((t - this.link.begin) / (this.link.end - this.link.begin)) * plot;
    const y = (v) => TOP + ((high - v) / (high - low)) * HEIGHT;
    Object.assign(panel, { low, high });
    this.drawAxes(pen, { x, y, low, high, plot, width, labelled: axis === AXIS, colors });
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, TOP, plot, HEIGHT);
    pen.clip();
    for (const one of shown) (one.std === null ? drawLine : drawBand)(pen, one, x, y);
    // Where the samples lie close they hide the band, not its edges.
    for (const one of shown) if (one.std !== null && one.wide) drawEdges(pen, one, x, y);
    pen.restore();
  }

  drawAxes(pen, { x, y, low, high, plot, width, labelled, colors }) {
    pen.font = `11px ${getComputedStyle(document.body).fontFamily}`;
    pen.lineWidth = 1;
    pen.strokeStyle = colors.rule;
    pen.fillStyle = colors.quiet;
    pen.beginPath();
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const [value, words] of ticks(low, high, 5)) {
      const at = Math.round(y(value)) + 0.5;
      pen.moveTo(LEFT, at);
      pen.lineTo(LEFT + plot, at);
      pen.fillText(words, LEFT - 6, at);
    }
    pen.textBaseline = "top";
    for (const [value, words] of ticks(this.link.begin, this.link.end, Math.max(2, plot / 75))) {
      const at = Math.round(x(value)) + 0.5;
      pen.moveTo(at, TOP);
      pen.lineTo(at, TOP + HEIGHT);
      if (!labelled) continue;
      pen.textAlign = at > width - 18 ? "right" : "center";
      pen.fillText(words, Math.min(at, width - 1), TOP + HEIGHT + 4);
    }
    pen.stroke();
    pen.textAlign = "center";
    if (labelled) pen.fillText("time [s]", LEFT + plot / 2, TOP + HEIGHT + 17);
  }

  // Reduce the visible samples to strokes of points; of each pixel column the first, lowest, highest and last.
  condense(panel, one, plot) {
    const { begin, end } = this.link, { time, cut } = this;
    const first = Math.max(index(time, begin) - 1, 0), last = Math.min(index(time, end) + 1, time.length);
    const std = one.std === null ? null : this.columns[one.std];
    const half = std === null ? () => 0 : (i) => this.spec.level * std[i];
    const wide = last - first > 4 * plot ? (end - begin) / plot : 0;
    const strokes = [];
    let stroke = null, cell = null;
    for (let i = first; i < last; i++) {
      const v = this.at(panel, one, i), h = half(i);
      if (Number.isNaN(v) || Number.isNaN(h)) {
        if (!wide) stroke = cell = null;
        continue;
      }
      if (cut[i] || stroke === null) {
        strokes.push((stroke = []));
        cell = null;
      }
      const place = wide ? Math.floor((time[i] - begin) / wide) : i;
      if (cell === null || cell.place !== place)
        stroke.push((cell = { place, t: time[i], first: v, low: v - h, high: v + h, last: v }));
      else {
        cell.low = Math.min(cell.low, v - h);
        cell.high = Math.max(cell.high, v + h);
        cell.last = v;
      }
    }
    return { ...one, strokes, wide };
  }

  // ---- reading values ----

  read() {
    const { cursor, begin, end } = this.link, { time } = this;
    const i = cursor === null ? -1 : nearest(time, cursor);
    const inside = i >= 0 && time[i] >= begin && time[i] <= end;
    this.clock.textContent = inside ? `at ${time[i].toFixed(2)} s` : "";
    const plot = this.panels[0].plot.clientWidth - LEFT - RIGHT;
    for (const panel of this.panels) {
      panel.cursor.hidden = !inside;
      panel.cursor.style.left = `${LEFT + ((time[i] - begin) / (end - begin)) * plot}px`;
      panel.value.replaceChildren(...(inside ? this.values(panel, i) : []));
    }
  }

  values(panel, i) {
    const step = panel.high - panel.low, shown = panel.series.filter((one) => !this.hidden.has(one.name));
    return shown.filter((one) => one.std === null || !shown.some((line) => line !== one && line.values === one.values))
      .map((one) => {
        const name = panel.series.length > 1 ? `${one.name} ` : "";
        const band = shown.find((other) => other.std !== null && other.values === one.values);
        const width = band ? ` ± ${written(this.spec.level * this.columns[band.std][i], step)}` : "";
        return element("span", { style: `border-color: var(--${one.color})` },
          `${name}${written(this.at(panel, one, i), step)}${width}`);
      });
  }

  speak() {
    const lines = this.panels.map((panel) => `${panel.box.querySelector("b").textContent}: ` +
      [...panel.value.children].map((one) => one.textContent).join(", "));
    this.spoken.textContent = this.clock.textContent ? `${this.clock.textContent}. ${lines.join(". ")}` : "";
  }

  // ---- hands ----

  listen() {
    const { grid, track } = this;
    this.fingers = new Map();
    grid.addEventListener("pointerdown", (event) => this.press(event));
    grid.addEventListener("pointermove", (event) => this.drag(event));
    for (const name of ["pointerup", "pointercancel"]) grid.addEventListener(name, (event) => this.release(event));
    grid.addEventListener("pointerleave", (event) => event.pointerType === "mouse" && this.point(null));
    grid.addEventListener("dblclick", () => this.show(this.link.low, this.link.high));
    grid.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    grid.addEventListener("keydown", (event) => this.key(event));
    track.addEventListener("pointerdown", (event) => this.grab(event));
    new ResizeObserver(() => this.stale()).observe(grid);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.stale());
  }

  // Time under a pointer, and the panel it is over.
  under(event) {
    const panel = this.panels.find((one) => one.plot.contains(event.target)) ?? this.panels[0];
    const box = (this.pressed?.panel ?? panel).plot.getBoundingClientRect();
    const part = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    const { begin, end } = this.link;
    return { panel, part, t: begin + Math.min(Math.max(part, 0), 1) * (end - begin) };
  }

  press(event) {
    if (event.button !== 0) return;
    const { panel, t } = this.under(event);
    this.fingers.set(event.pointerId, event.clientX);
    this.pressed = { panel, t, x: event.clientX, begin: this.link.begin, end: this.link.end };
    this.point(t);
    if (event.pointerType === "mouse") this.grid.setPointerCapture(event.pointerId);
  }

  drag(event) {
    const { pressed, fingers } = this;
    if (!fingers.has(event.pointerId)) {
      if (event.pointerType === "mouse") this.point(this.under(event).t);
      return;
    }
    const before = [...fingers.values()];
    fingers.set(event.pointerId, event.clientX);
    const width = pressed.panel.plot.clientWidth - LEFT - RIGHT;
    if (fingers.size === 2) {
      const [a, b] = before, [c, d] = [...fingers.values()];
      const { begin, end } = this.link, left = pressed.panel.plot.getBoundingClientRect().left + LEFT;
      const about = begin + (((a + b) / 2 - left) / width) * (end - begin);
      this.zoom(Math.max(Math.abs(a - b), 10) / Math.max(Math.abs(c - d), 10), about);
      this.move(-(c + d - a - b) / 2 / width);
    } else if (event.pointerType === "mouse" && !event.shiftKey) this.pick(pressed, this.under(event).t);
    else {
      this.move((before[0] - event.clientX) / width);
      this.point(this.under(event).t);
    }
  }

  // Mark the seconds between the press and here.
  pick(pressed, t) {
    const { begin, end } = this.link, width = pressed.panel.plot.clientWidth - LEFT - RIGHT;
    const [a, b] = [Math.min(t, pressed.t), Math.max(t, pressed.t)];
    pressed.picked = [a, b];
    for (const { picked } of this.panels) {
      picked.hidden = false;
      picked.style.left = `${LEFT + ((a - begin) / (end - begin)) * width}px`;
      picked.style.width = `${((b - a) / (end - begin)) * width}px`;
    }
    this.point(t);
  }

  release(event) {
    if (!this.fingers.delete(event.pointerId)) return;
    const { picked, x } = this.pressed;
    for (const panel of this.panels) panel.picked.hidden = true;
    if (picked && Math.abs(event.clientX - x) > 4 && event.type === "pointerup") this.show(...picked);
    if (!this.fingers.size) this.pressed = null;
  }

  wheel(event) {
    const sideways = Math.abs(event.deltaX) > Math.abs(event.deltaY);
    // Plain turning scrolls the page, unless the chart was clicked into.
    if (!event.ctrlKey && !sideways && document.activeElement !== this.grid) return;
    event.preventDefault();
    if (sideways) this.move(event.deltaX / 1000);
    else this.zoom(Math.exp(Math.min(Math.max(event.deltaY, -200), 200) / (event.ctrlKey ? 200 : 500)), this.under(event).t);
  }

  key(event) {
    const { link } = this, step = (link.end - link.begin) / (event.shiftKey ? 10 : 100);
    const at = link.cursor ?? (link.begin + link.end) / 2;
    const acts = {
      ArrowLeft: () => this.follow(at - step),
      ArrowRight: () => this.follow(at + step),
      Home: () => this.follow(link.low),
      End: () => this.follow(link.high),
      "+": () => this.zoom(0.5, at),
      "=": () => this.zoom(0.5, at),
      "-": () => this.zoom(2, at),
      0: () => this.show(link.low, link.high),
      Escape: () => this.point(null),
    };
    if (!acts[event.key] || event.altKey || event.metaKey || event.ctrlKey) return;
    event.preventDefault();
    acts[event.key]();
    this.speak();
  }

  // Put the cursor somewhere, and the visible seconds around it.
  follow(t) {
    const { link } = this;
    t = Math.min(Math.max(t, link.low), link.high);
    const by = t < link.begin ? t - link.begin : t > link.end ? t - link.end : 0;
    if (by) this.show(link.begin + by, link.end + by);
    this.point(t);
  }

  // Drag the bar of the visible seconds.
  grab(event) {
    const { track, link } = this, box = track.getBoundingClientRect(), length = link.end - link.begin;
    const time = (x) => link.low + ((x - box.left) / box.width) * (link.high - link.low);
    const held = time(event.clientX);
    const off = held >= link.begin && held <= link.end ? held - link.begin : length / 2;
    const go = (x) => {
      const begin = Math.min(Math.max(time(x) - off, link.low), link.high - length);
      this.show(begin, begin + length);
    };
    event.preventDefault();
    track.setPointerCapture(event.pointerId);
    go(event.clientX);
    const follow = (moved) => go(moved.clientX);
    track.addEventListener("pointermove", follow);
    const done = () => track.removeEventListener("pointermove", follow);
    for (const name of ["pointerup", "pointercancel"]) track.addEventListener(name, done, { once: true });
  }
}

// ---- maps ---------------------------------------------------------------------------------------

// Marks on the maps the place where a flight was at the cursor.
class Track {
  constructor(map, { link, time, east, north }) {
    Object.assign(this, { link: links.get(link), time, east, north });
    this.marks = [...map.querySelectorAll("svg[data-map]")].map((svg) => {
      const mark = document.createElementNS(map.querySelector("svg").namespaceURI, "circle");
      mark.setAttribute("class", "place");
      mark.setAttribute("r", "4");
      mark.setAttribute("visibility", "hidden");
      svg.append(mark);
      return { mark, scale: svg.dataset.map.split(" ").map(Number) };
    });
    this.link.tracks.push(this);
  }

  read() {
    const { time } = this, { cursor } = this.link;
    const known = cursor !== null && cursor >= time[0] && cursor <= time[time.length - 1];
    const k = known ? Math.min(Math.max(index(time, cursor), 1), time.length - 1) : 1;
    const part = (cursor - time[k - 1]) / (time[k] - time[k - 1]);
    const place = (values) => values[k - 1] + part * (values[k] - values[k - 1]);
    for (const { mark, scale: [a, b, c, d] } of this.marks) {
      mark.setAttribute("visibility", known ? "visible" : "hidden");
      mark.setAttribute("cx", known ? a + b * place(this.east) : 0);
      mark.setAttribute("cy", known ? c + d * place(this.north) : 0);
    }
  }
}

// ---- begin --------------------------------------------------------------------------------------

async function begin() {
  if (!("DecompressionStream" in window)) return; // the pictures remain
  for (const figure of document.querySelectorAll("figure.chart")) {
    const holder = figure.querySelector('script[type="application/json"]');
    const spec = JSON.parse(holder.textContent);
    const chart = new Chart(figure, spec, await unpack(spec));
    chart.draw();
  }
  for (const map of document.querySelectorAll(".map"))
    for (const track of JSON.parse(map.querySelector('script[type="application/json"]').textContent))
      if (links.has(track.link) && track.time.length > 1) new Track(map, track);
  document.documentElement.dataset.charts = "ready";
}

begin();
