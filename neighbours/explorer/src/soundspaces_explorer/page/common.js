"use strict";
// What both pages have: requests, the audio graph's nodes, canvases with axes, marks.

const BANDS = ["#0072b2", "#009e73", "#e69f00", "#cc79a7", "#56b4e9", "#d55e00", "#777777", "#000000"];
const FADE_S = 0.08, DEVICE_S = 3; // s of a cross-fade; that the audio device may take to start
const LEFT = 46, RIGHT = 66, TOP = 30, BOTTOM = 40; // px about the plan: axes, colour bar, scale bar
const $ = (id) => document.getElementById(id);

async function get(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error((await answer.json().catch(() => ({}))).error || `${answer.status}`);
  return answer;
}

const split = (flat) => [flat.subarray(0, flat.length / 2), flat.subarray(flat.length / 2)];

function buffer(context, channels) {
  const out = context.createBuffer(channels.length, Math.max(channels[0].length, 1), context.sampleRate);
  channels.forEach((samples, c) => out.copyToChannel(new Float32Array(samples), c));
  return out;
}

function ears(context, channels) {
  const node = context.createConvolver();
  node.normalize = false; // the reader's samples are what is heard
  node.buffer = buffer(context, channels);
  return node;
}

// Firefox waits for ever where there is no device.
async function resumed(context) {
  const late = new Promise((_, fail) => setTimeout(fail, DEVICE_S * 1000, new Error("the browser found no device to play sound on")));
  await Promise.race([context.resume(), late]);
}

// Let `next` be heard after `input` instead of `before`, {node, gain}, in a cross-fade; what is heard now.
function crossfaded(context, input, output, channels, before) {
  const time = context.currentTime;
  const next = { node: ears(context, channels), gain: new GainNode(context, { gain: 0 }) };
  input.connect(next.node).connect(next.gain).connect(output);
  next.gain.gain.setValueAtTime(0, time);
  next.gain.gain.linearRampToValueAtTime(1, time + FADE_S);
  if (before) {
    before.gain.gain.cancelScheduledValues(time);
    before.gain.gain.setValueAtTime(before.gain.gain.value, time);
    before.gain.gain.linearRampToValueAtTime(0, time + FADE_S);
    setTimeout(() => { input.disconnect(before.node); before.gain.disconnect(); }, 1000 * FADE_S + 200);
  }
  return next;
}

async function monoOf(context, file) {
  const decoded = await context.decodeAudioData(await file.arrayBuffer()), mono = new Float32Array(decoded.length);
  for (let c = 0; c < decoded.numberOfChannels; c++)
    decoded.getChannelData(c).forEach((x, i) => { mono[i] += x / decoded.numberOfChannels; });
  return mono;
}

// ---- canvases --------------------------------------------------------------------------------------------------------

function canvas(id) {
  const element = $(id), ratio = window.devicePixelRatio || 1;
  element.width = Math.round(element.clientWidth * ratio);
  element.height = Math.round(element.clientHeight * ratio);
  const pen = element.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  return [pen, element.clientWidth, element.clientHeight];
}

// As high as a rectangle needs at this width, and no higher than the style allows (`--most`).
function shaped(id, low, high, right = RIGHT) {
  const element = $(id), needed = TOP + BOTTOM + (element.clientWidth - LEFT - right) * (high[1] - low[1]) / Math.max(high[0] - low[0], 1e-3);
  element.style.height = `min(var(--most), ${Math.round(Math.max(needed, 160))}px)`;
}

const minus = (text) => `${text}`.replace("-", "−");

// The least of 1, 2, 5, 10, … that is at least so much.
function round(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return power * [1, 2, 5, 10].find((k) => k * power >= least * (1 - 1e-9));
}

function ticks(low, high, step) {
  const out = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) out.push(k * step);
  return out;
}

function label(pen, text, x, y, align = "center", turned = false) {
  pen.save(); pen.translate(x, y); if (turned) pen.rotate(-Math.PI / 2);
  pen.font = "11px system-ui"; pen.fillStyle = "#555"; pen.textAlign = align; pen.textBaseline = "middle";
  pen.fillText(text, 0, 0);
  pen.restore();
}

function drawAxes(pen, { scale, low, high, at }, names = ["x (m)", "y (m)"]) {
  const step = round(48 / scale), digits = step < 1 ? Math.ceil(-Math.log10(step)) : 0;
  const [left, bottom] = at(low), [right, top] = at(high), number = (v) => minus((+v.toFixed(digits) + 0).toFixed(digits));
  pen.lineWidth = 1; pen.strokeStyle = "#999"; pen.beginPath();
  pen.moveTo(left - 8, top); pen.lineTo(left - 8, bottom + 8); pen.lineTo(right, bottom + 8);
  for (const v of ticks(low[0], high[0], step)) {
    const [x] = at([v, 0]);
    pen.moveTo(x, bottom + 8); pen.lineTo(x, bottom + 12); label(pen, number(v), x, bottom + 19);
  }
  for (const v of ticks(low[1], high[1], step)) {
    const [, y] = at([0, v]);
    pen.moveTo(left - 12, y); pen.lineTo(left - 8, y); label(pen, number(v), left - 15, y, "right");
  }
  pen.stroke();
  label(pen, names[0], (left + right) / 2, bottom + 32);
  label(pen, names[1], left - 38, (top + bottom) / 2, "center", true);
  pen.lineWidth = 3; pen.strokeStyle = "#1b1b1b"; pen.beginPath();
  pen.moveTo(left, top - 14); pen.lineTo(left + step * scale, top - 14); pen.stroke();
  label(pen, `${step} m`, left + step * scale + 6, top - 14, "left");
}

function star(pen, x, y) {
  pen.beginPath();
  for (let k = 0; k < 10; k++) {
    const r = k % 2 ? 4.5 : 11, a = Math.PI * (k / 5 - 0.5);
    pen.lineTo(x + r * Math.cos(a), y + r * Math.sin(a));
  }
  pen.closePath(); pen.fillStyle = "#d55e00"; pen.strokeStyle = "#fff"; pen.lineWidth = 1.5; pen.fill(); pen.stroke();
}

function head(pen, x, y, heading) {
  const a = -heading * Math.PI / 180;
  pen.save(); pen.translate(x, y); pen.rotate(a);
  pen.beginPath(); pen.moveTo(17, 0); pen.lineTo(8, -6); pen.lineTo(8, 6); pen.closePath(); // the nose
  pen.fillStyle = "#0072b2"; pen.strokeStyle = "#fff"; pen.lineWidth = 1.5; pen.fill(); pen.stroke();
  pen.beginPath(); pen.arc(0, 0, 9, 0, 7); pen.fill(); pen.stroke();
  pen.fillRect(-3, -13, 6, 4); pen.fillRect(-3, 9, 6, 4); // ears
  pen.restore();
}

// No line ends at the dash.
function bandText(low, high) {
  const kilo = high >= 1000, text = (f) => kilo ? `${+(f / 1000).toFixed(f < 1000 ? 2 : 1)}` : `${Math.round(f)}`;
  return `${text(low)}\u2060–\u2060${text(high)} ${kilo ? "kHz" : "Hz"}`;
}
const number = (v, digits) => v === null ? "–" : minus((+v.toFixed(digits) + 0).toFixed(digits));

// Metres to pixels and back for a rectangle of the plan, with room for axes and scale bar.
function fitted(low, high, width, height, right = RIGHT) {
  const scale = Math.min((width - LEFT - right) / Math.max(high[0] - low[0], 1e-3), (height - TOP - BOTTOM) / Math.max(high[1] - low[1], 1e-3));
  const dx = LEFT + (width - LEFT - right - scale * (high[0] - low[0])) / 2, dy = BOTTOM + (height - TOP - BOTTOM - scale * (high[1] - low[1])) / 2;
  return { scale, low, high, at: (p) => [dx + scale * (p[0] - low[0]), height - dy - scale * (p[1] - low[1])],
    back: (x, y) => [(x - dx) / scale + low[0], (height - dy - y) / scale + low[1]] };
}
