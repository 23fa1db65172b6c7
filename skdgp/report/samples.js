"use strict";
// Samples out of the page, what of them can be seen, and how it is drawn.

const BAND_ROOM = 0.6; // a band widens the vertical axis by at most this part of the lines' own range
const GAP = 5; // a step longer than this many usual ones breaks the lines

const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

// ---- samples ------------------------------------------------------------------------------------

async function unpack(spec) {
  const packed = Uint8Array.from(atob(spec.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  return spec.columns.map(([low, step], k) => column(bytes, 4 * k * spec.n, spec.n, low, step));
}

function column(bytes, at, n, low, step) {
  const values = new Float64Array(n);
  for (let i = 0, count = 0; i < n; i++) {
    const [a, b, c, d] = [bytes[at + i], bytes[at + n + i], bytes[at + 2 * n + i], bytes[at + 3 * n + i]];
    const folded = a + b * 256 + c * 65536 + d * 16777216;
    count += folded % 2 ? -(folded + 1) / 2 : folded / 2;
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
  const range = (some, room) => {
    let low = Infinity, high = -Infinity;
    for (const { strokes } of some) for (const cell of strokes.flat()) {
      low = Math.min(low, cell.low);
      high = Math.max(high, cell.high);
    }
    return [low - room * (high - low), high + room * (high - low)];
  };
  const lines = shown.filter((one) => one.std === null), bands = shown.filter((one) => one.std !== null);
  let [low, high] = range(lines.length ? lines : bands, 0);
  if (lines.length && bands.length) {
    const room = range(lines, BAND_ROOM), wide = range(bands, 0);
    [low, high] = [Math.min(low, Math.max(room[0], wide[0])), Math.max(high, Math.min(room[1], wide[1]))];
  }
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

function drawEdges(pen, one, x, y) {
  pen.strokeStyle = color(one.color);
  pen.lineWidth = 1.2;
  pen.beginPath();
  for (const stroke of one.strokes) for (const edge of ["high", "low"])
    stroke.forEach((cell, k) => (k ? pen.lineTo(x(cell.t), y(cell[edge])) : pen.moveTo(x(cell.t), y(cell[edge]))));
  pen.stroke();
}

function drawBand(pen, one, x, y) {
  pen.fillStyle = color(one.color);
  pen.globalAlpha = 0.45;
  pen.beginPath();
  for (const stroke of one.strokes) {
    stroke.forEach(({ t, high }, k) => (k ? pen.lineTo(x(t), y(high)) : pen.moveTo(x(t), y(high))));
    for (let k = stroke.length - 1; k >= 0; k--) pen.lineTo(x(stroke[k].t), y(stroke[k].low));
    pen.closePath();
  }
  pen.fill();
  pen.globalAlpha = 1;
}
