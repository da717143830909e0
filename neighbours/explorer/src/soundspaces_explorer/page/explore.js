"use strict";
// The explorer's page. State in one object; everything that is drawn or heard follows from it.
// Data come from the server beside this page, or, opened from disk, from scripts beside it (`explorerData`).

const HEADING_STEP = 10;
const state = { name: "", data: null, source: 0, listener: 0, heading: 0, storey: 0, pair: null, field: null };

// ---- where data come from -------------------------------------------------------------------------------------------

const fromDisk = location.protocol === "file:";
const waiting = new Map();
const received = new Map();
window.explorerData = (kind, content) => {
  const key = kind === "source" ? `source-${content.source}` : kind;
  received.set(key, content);
  (waiting.get(key) || []).forEach((give) => give(content));
  waiting.delete(key);
};

function script(name, key) {
  if (received.has(key)) return Promise.resolve(received.get(key));
  return new Promise((give, fail) => {
    waiting.set(key, [...(waiting.get(key) || []), give]);
    const tag = document.createElement("script");
    tag.src = name;
    tag.onerror = () => fail(new Error(`${name} is missing`));
    document.head.append(tag);
  });
}

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;

const server = {
  datasets: async () => (await get("api/datasets")).json(),
  overview: async (d) => (await get(`api/${encodeURIComponent(d)}/overview`)).json(),
  pair: async (d, s, l) => (await get(`api/${encodeURIComponent(d)}/pair?s=${s}&l=${l}`)).json(),
  field: async (d, s) => (await (await get(`api/${encodeURIComponent(d)}/field?s=${s}`)).json()).level,
  response: async (d, s, l, heading) =>
    split(new Float32Array(await (await get(`api/${encodeURIComponent(d)}/response?s=${s}&l=${l}&heading=${heading}`)).arrayBuffer())),
  sound: async (d, name) => new Float32Array(await (await get(`api/${encodeURIComponent(d)}/sound?name=${name}`)).arrayBuffer()),
};

const disk = {
  datasets: async () => {
    const all = await script("data.js", "overview");
    return { datasets: [all.name], sounds: Object.keys(all.sounds) };
  },
  overview: async () => script("data.js", "overview"),
  pair: async (d, s, l) => (await script(`source-${s}.js`, `source-${s}`)).pairs[l],
  field: async (d, s) => (await script(`source-${s}.js`, `source-${s}`)).level,
  response: async (d, s, l, heading) => {
    // headings that were exported, and between two of them their mixture
    const pair = (await script(`source-${s}.js`, `source-${s}`)).pairs[l];
    const { headings } = received.get("overview");
    const whole = new Int16Array(bytes(pair.ears)), n = whole.length / (2 * headings.length);
    const turn = ((heading % 360) + 360) % 360 / (360 / headings.length);
    const low = Math.floor(turn) % headings.length, share = turn - Math.floor(turn);
    const out = [new Float32Array(n), new Float32Array(n)];
    for (const [k, weight] of [[low, 1 - share], [(low + 1) % headings.length, share]])
      for (let ear = 0; ear < 2; ear++)
        for (let i = 0; i < n; i++) out[ear][i] += weight * pair.peak / 32767 * whole[(2 * k + ear) * n + i];
    return out;
  },
  sound: async (d, name) => new Float32Array(bytes((await script("data.js", "overview")).sounds[name])),
};

const data = fromDisk ? disk : server;
const choices = () => state.data.chosen || state.data.points.map((_, i) => i);

// ---- sound: input -> the convolver of this pair and heading, cross-faded with the one before -> volume ---------------

const audio = { context: null, input: null, volume: null, now: null, playing: null, stream: null, wanted: 0 };

async function start() {
  if (!audio.context || audio.context.sampleRate !== state.data.rate) {
    if (audio.context) await audio.context.close();
    audio.context = new AudioContext({ sampleRate: state.data.rate });
    audio.input = new GainNode(audio.context);
    audio.volume = new GainNode(audio.context, { gain: Number($("volume").value) });
    audio.volume.connect(audio.context.destination);
    audio.now = audio.playing = null;
  }
  await resumed(audio.context);
}

async function listen() {
  if (!audio.context) return;
  const asked = ++audio.wanted;
  const channels = await data.response(state.name, state.source, state.listener, state.heading);
  if (asked !== audio.wanted) return; // somebody has moved on
  audio.now = crossfaded(audio.context, audio.input, audio.volume, channels, audio.now);
}

function stop() {
  if (audio.playing) { audio.playing.stop?.(); audio.playing.disconnect(); audio.playing = null; }
  if (audio.stream) { audio.stream.getTracks().forEach((t) => t.stop()); audio.stream = null; }
  $("play").setAttribute("aria-pressed", "false");
  $("play").textContent = "Play";
  $("mic").setAttribute("aria-pressed", "false");
}

async function dry() {
  const file = $("file").files[0];
  if ($("sound").value === "file" && file) {
    return monoOf(audio.context, file);
  }
  return data.sound(state.name, $("sound").value);
}

async function play() {
  if (audio.playing) { stop(); return; }
  stop();
  await start();
  const samples = await dry();
  const node = new AudioBufferSourceNode(audio.context, { buffer: buffer(audio.context, [samples]), loop: true });
  node.connect(audio.input);
  await listen();
  node.start();
  audio.playing = node;
  $("play").setAttribute("aria-pressed", "true");
  $("play").textContent = "Stop";
}

async function microphone() {
  if (audio.stream) { stop(); return; }
  stop();
  await start();
  audio.stream = await navigator.mediaDevices.getUserMedia({ audio: { echoCancellation: true, noiseSuppression: false } });
  audio.playing = audio.context.createMediaStreamSource(audio.stream);
  audio.playing.connect(audio.input);
  await listen();
  $("mic").setAttribute("aria-pressed", "true");
}

// What the graph makes of a sound, off line: the same nodes, for tests.
window.explorerRender = async (samples, s, l, heading) => {
  const channels = await data.response(state.name, s, l, heading);
  const context = new OfflineAudioContext(2, samples.length + channels[0].length, state.data.rate);
  const node = new AudioBufferSourceNode(context, { buffer: buffer(context, [Float32Array.from(samples)]) });
  node.connect(ears(context, channels)).connect(context.destination);
  node.start();
  const out = await context.startRendering();
  return [Array.from(out.getChannelData(0)), Array.from(out.getChannelData(1))];
};

// ---- the plan --------------------------------------------------------------------------------------------------------

function extent() {
  const all = [...state.data.walls[state.storey] || [], ...state.data.points.map((p) => [p[0], p[1], p[0], p[1]])];
  let [x0, y0, x1, y1] = [Infinity, Infinity, -Infinity, -Infinity];
  for (const w of all) {
    x0 = Math.min(x0, w[0], w[2]); x1 = Math.max(x1, w[0], w[2]);
    y0 = Math.min(y0, w[1], w[3]); y1 = Math.max(y1, w[1], w[3]);
  }
  return [[x0, y0], [x1, y1]];
}

const view = (width, height) => fitted(...extent(), width, height);

function drawColours(pen, low, high, { at, ...box }) {
  const [right, top] = at(box.high), [, bottom] = at(box.low), x = right + 14, tall = bottom - top;
  for (let k = 0; k < tall; k++) { pen.fillStyle = colour(1 - k / tall); pen.fillRect(x, top + k, 12, 1.5); }
  for (const db of ticks(low, high, round((high - low) * 24 / Math.max(tall, 24)) || 1))
    label(pen, minus(+db.toFixed(1)), x + 16, bottom - tall * (db - low) / Math.max(high - low, 1e-9), "left");
  label(pen, "dB", x + 6, top - 12);
}

// Viridis, five stops.
const COLOURS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
function colour(share) {
  const x = Math.max(0, Math.min(0.9999, share)) * 4, k = Math.floor(x), f = x - k;
  return `rgb(${COLOURS[k].map((c, i) => Math.round(c + f * (COLOURS[k + 1][i] - c))).join(",")})`;
}

const here = (i) => state.data.storey[i] === state.storey;

function drawPlan() {
  if (state.data) shaped("plan", ...extent());
  const [pen, width, height] = canvas("plan");
  pen.clearRect(0, 0, width, height);
  if (!state.data) return;
  const seen = view(width, height), { scale, at } = seen, points = state.data.points;
  drawAxes(pen, seen);
  const known = new Set(choices());
  const levels = (state.field || []).filter((x, i) => x !== null && i !== state.source);
  if (levels.length && $("show-map").checked) {
    const top = Math.max(...levels), low = Math.max(Math.min(...levels), top - 50);
    const size = scale * state.data.spacing;
    points.forEach((p, i) => {
      if (!here(i) || i === state.source || state.field[i] === null) return; // at the source itself it is that of 5 cm
      const [x, y] = at(p);
      pen.fillStyle = colour((state.field[i] - low) / Math.max(top - low, 1e-9));
      pen.fillRect(x - size / 2, y - size / 2, size, size);
    });
    drawColours(pen, low, top, seen);
    $("scale").textContent = "Level: mean of all bands, dB re the direct sound at 1 m";
  } else $("scale").textContent = "";
  pen.lineWidth = 1.6; pen.strokeStyle = "#1b1b1b";
  pen.beginPath();
  for (const w of state.data.walls[state.storey] || []) { pen.moveTo(...at(w)); pen.lineTo(...at([w[2], w[3]])); }
  pen.stroke();
  points.forEach((p, i) => {
    if (!here(i)) return;
    pen.beginPath(); pen.arc(...at(p), known.has(i) ? 3 : 1.5, 0, 7);
    pen.fillStyle = known.has(i) ? "#ffffff" : "#bbbbbb"; pen.fill();
    pen.lineWidth = 1; pen.strokeStyle = "#1b1b1b"; pen.stroke();
  });
  if (state.pair && $("show-rays").checked) drawRays(pen, at);
  const [sx, sy] = at(points[state.source]), [lx, ly] = at(points[state.listener]);
  star(pen, sx, sy);
  head(pen, lx, ly, state.heading);
}

function drawRays(pen, at) {
  const s = state.data.points[state.source], l = state.data.points[state.listener];
  const loudest = Math.max(...state.pair.arrivals.map((a) => a.level));
  for (const a of state.pair.arrivals) {
    const length = a.delay * state.data.speedOfSound;
    const image = l.map((x, k) => x + length * a.direction[k]);
    pen.globalAlpha = Math.max(0.15, 1 - (loudest - a.level) / 25);
    pen.strokeStyle = a.order === 0 ? "#d55e00" : a.order === 1 ? "#e69f00" : "#56b4e9";
    pen.lineWidth = a.order === 0 ? 2.5 : 1.5;
    pen.beginPath();
    pen.moveTo(...at(l));
    if (a.order === 0) pen.lineTo(...at(s));
    else if (a.order === 1) { pen.lineTo(...at(mirrorPoint(s, image, l))); pen.lineTo(...at(s)); }
    else { // where it met the second wall is known, not how far it came from the first: a short piece
      const part = 0.35 / Math.max(Math.hypot(a.direction[0], a.direction[1]), 0.35);
      pen.setLineDash([4, 3]);
      pen.lineTo(...at([l[0] + part * a.direction[0], l[1] + part * a.direction[1]]));
    }
    pen.stroke();
    pen.setLineDash([]);
  }
  pen.globalAlpha = 1;
}

// The mirror lies half way between a source and its image, across the line between them.
function mirrorPoint(s, image, l) {
  const n = image.map((x, k) => x - s[k]), middle = image.map((x, k) => (x + s[k]) / 2);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const way = image.map((x, k) => x - l[k]);
  const t = dot(n, middle.map((x, k) => x - l[k])) / (dot(n, way) || 1e-9);
  return l.map((x, k) => x + t * way[k]);
}

// ---- decay curves and numbers ----------------------------------------------------------------------------------------

const bandName = (b) => bandText(state.data.bands[b], state.data.bands[b + 1]);

function drawDecay() {
  const [pen, width, height] = canvas("decay");
  pen.clearRect(0, 0, width, height);
  if (!state.pair) return;
  const { decay, binSeconds, error } = state.pair, end = decay[0].length * binSeconds, low = -60;
  const x = (t) => 52 + (width - 66) * t / end, y = (db) => 10 + (height - 52) * db / low;
  pen.strokeStyle = "#e5e5e5"; pen.lineWidth = 1;
  for (let db = 0; db >= low; db -= 10) {
    pen.beginPath(); pen.moveTo(x(0), y(db)); pen.lineTo(x(end), y(db)); pen.stroke();
    if (db % 20 === 0) label(pen, minus(db), 46, y(db), "right");
  }
  const step = round(end * 56 / (width - 66)), digits = Math.max(Math.ceil(-Math.log10(step)), 0);
  for (const t of ticks(0, end, step)) label(pen, t.toFixed(digits), x(t), height - 32);
  label(pen, "time since emission (s)", (x(0) + x(end)) / 2, height - 12);
  label(pen, "decay (dB re all energy)", 12, y(low / 2), "center", true);
  pen.font = "11px system-ui";
  decay.forEach((curve, b) => {
    const shown = curve.map((db, i) => [i * binSeconds, db]).filter(([, db]) => db >= low);
    const share = 2 * (error[1][b] || 0), up = 10 * Math.log10(1 + share), down = 10 * Math.log10(Math.max(1 - share, 1e-3));
    pen.fillStyle = pen.strokeStyle = BANDS[b % BANDS.length];
    pen.globalAlpha = 0.15; pen.beginPath();
    shown.forEach(([t, db]) => pen.lineTo(x(t), y(Math.min(db + up, 0))));
    [...shown].reverse().forEach(([t, db]) => pen.lineTo(x(t), y(Math.max(db + down, low))));
    pen.fill(); pen.globalAlpha = 1; pen.lineWidth = 1.8; pen.beginPath();
    shown.forEach(([t, db]) => pen.lineTo(x(t), y(db)));
    pen.stroke();
    pen.fillText(bandName(b), width - 130, 24 + 15 * b);
  });
}

const UNITS = { t20: ["T20", "s", 2], t30: ["T30", "s", 2], edt: ["EDT", "s", 2], c50: ["C50", "dB", 1], c80: ["C80", "dB", 1], d50: ["D50", "", 2],
  drr: ["DRR", "dB", 1] };
function addRow(table, name, cells, kind) {
  const tr = table.insertRow();
  const th = document.createElement("th");
  th.textContent = name; tr.append(th);
  for (const text of cells) { const td = document.createElement(kind); td.textContent = text; tr.append(td); }
}

function addMeasures(table, measures) {
  for (const [name, values] of Object.entries(measures)) {
    const [label, unit, digits] = UNITS[name];
    addRow(table, unit ? `${label} (${unit})` : label, values.map((v) => number(v, digits)), "td");
  }
}

function tell() {
  const p = state.pair;
  $("pair").textContent = p ? `From point ${p.source} to point ${p.listener}: ${p.distance.toFixed(2)} m, ${p.visible ? "in sight" : "out of sight"}, ` +
    `${p.arrivals.length} discrete arrivals; the head faces ${((state.heading % 360) + 360) % 360}°.` : "";
  const table = $("measures"), low = $("waves");
  table.replaceChildren(); low.replaceChildren();
  if (!p) return;
  addRow(table, "", p.decay.map((_, b) => bandName(b)), "th");
  addMeasures(table, p.measures);
  addRow(table, "error to 80 ms", p.error[0].map((v) => v === null ? "–" : `${(100 * v).toFixed(1)} %`), "td");
  addRow(table, "error later", p.error[1].map((v) => v === null ? "–" : `${(100 * v).toFixed(1)} %`), "td");
  if (!p.waves) return;
  low.createCaption().textContent = `Waves below ${p.waves.edge.toFixed(0)} Hz, in octaves`;
  addRow(low, "", p.waves.bands.map((f) => `${f} Hz`), "th");
  addRow(low, "Level re 1 m (dB)", p.waves.level.map((v) => number(v, 1)), "td");
  addMeasures(low, p.waves.measures);
}

// ---- what changes -----------------------------------------------------------------------------------------------------

const complain = (error) => { $("status").textContent = error ? `${error.message || error}` : ""; };
const guarded = (action) => (...given) => { complain(""); return Promise.resolve(action(...given)).catch(complain); };

async function changed(sourceToo) {
  const { name, source, listener } = state;
  drawPlan();
  const [pair, field] = await Promise.all([
    data.pair(name, source, listener), sourceToo || !state.field ? data.field(name, source) : state.field]);
  if (name !== state.name || source !== state.source || listener !== state.listener) return;
  state.pair = pair; state.field = field;
  drawPlan(); drawDecay(); tell();
  document.body.dataset.pair = `${source},${listener}`;
  await listen();
}

const move = guarded(async (end, point) => {
  if (point === undefined || state[end] === point) return;
  state[end] = point;
  await changed(end === "source");
});

const turn = guarded(async (heading) => {
  state.heading = Math.round(heading / HEADING_STEP) * HEADING_STEP;
  drawPlan(); tell();
  await listen();
});

const open = guarded(async (name) => {
  stop();
  state.data = await data.overview(name);
  Object.assign(state, { name, pair: null, field: null, heading: 0 });
  const known = choices();
  state.source = known[0];
  state.listener = known[Math.min(known.length - 1, Math.floor(known.length / 2))];
  state.storey = state.data.storey[state.listener];
  $("title").textContent = `${name}: ${state.data.points.length} points`;
  $("storey").replaceChildren(...state.data.walls.map((_, k) => new Option(`${k + 1}`, k, false, k === state.storey)));
  $("storey-label").hidden = state.data.walls.length < 2;
  await changed(true);
  document.body.dataset.ready = name;
});

function nearest(x, y) {
  const box = $("plan"), { back } = view(box.clientWidth, box.clientHeight), [px, py] = back(x, y);
  let best, least = Infinity;
  for (const i of choices()) {
    if (!here(i)) continue;
    const d = Math.hypot(state.data.points[i][0] - px, state.data.points[i][1] - py);
    if (d < least) [least, best] = [d, i];
  }
  return best;
}

function neighbour(from, dx, dy) {
  const p = state.data.points;
  let best, least = Infinity;
  for (const i of choices()) {
    if (i === from || !here(i)) continue;
    const [ax, ay] = [p[i][0] - p[from][0], p[i][1] - p[from][1]], along = ax * dx + ay * dy;
    if (along <= 1e-6) continue;
    const cost = along + 2.5 * Math.abs(ax * dy - ay * dx);
    if (cost < least) [least, best] = [cost, i];
  }
  return best;
}

function wire() {
  const plan = $("plan");
  let dragging = false;
  const place = (event) => { const box = plan.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
  const angle = (event) => {
    const { at } = view(plan.clientWidth, plan.clientHeight), [x, y] = at(state.data.points[state.listener]), [px, py] = place(event);
    return Math.atan2(y - py, px - x) * 180 / Math.PI;
  };
  plan.addEventListener("pointerdown", (event) => {
    if (!state.data) return;
    plan.focus();
    const { at } = view(plan.clientWidth, plan.clientHeight), [x, y] = place(event), [lx, ly] = at(state.data.points[state.listener]);
    const source = event.shiftKey || event.button === 2 || $("moves").value === "source"; // a finger has no Shift
    if (Math.hypot(x - lx, y - ly) < 18 && !source) {
      dragging = true;
      plan.setPointerCapture(event.pointerId);
    } else move(source ? "source" : "listener", nearest(x, y));
  });
  plan.addEventListener("pointermove", (event) => { if (dragging) turn(angle(event)); });
  plan.addEventListener("pointerup", () => { dragging = false; });
  plan.addEventListener("contextmenu", (event) => event.preventDefault());
  document.addEventListener("keydown", (event) => {
    if (!state.data || ["SELECT", "INPUT"].includes(event.target.tagName) || event.ctrlKey || event.metaKey || event.altKey) return;
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    const end = event.shiftKey ? "source" : "listener";
    if (way) move(end, neighbour(state[end], ...way));
    else if (event.key === "," || event.key === "<") turn(state.heading + HEADING_STEP);
    else if (event.key === "." || event.key === ">") turn(state.heading - HEADING_STEP);
    else if (event.key === " " && event.target.tagName !== "BUTTON") guarded(play)();
    else if (event.key === "m" || event.key === "r") { const box = $(event.key === "m" ? "show-map" : "show-rays"); box.checked = !box.checked; drawPlan(); }
    else return;
    event.preventDefault();
  });
  $("dataset").addEventListener("change", (event) => open(event.target.value));
  $("storey").addEventListener("change", (event) => { state.storey = Number(event.target.value); drawPlan(); });
  $("play").addEventListener("click", guarded(play));
  $("mic").addEventListener("click", guarded(microphone));
  $("sound").addEventListener("change", guarded(async () => { if (audio.playing && !audio.stream) { stop(); await play(); } }));
  $("file").addEventListener("change", guarded(async () => { $("sound").value = "file"; if (audio.playing) stop(); await play(); }));
  $("volume").addEventListener("input", () => { if (audio.volume) audio.volume.gain.value = Number($("volume").value); });
  for (const id of ["show-map", "show-rays"]) $(id).addEventListener("change", drawPlan);
  window.addEventListener("resize", () => { drawPlan(); drawDecay(); });
}

guarded(async () => {
  wire();
  const { datasets, sounds } = await data.datasets();
  $("dataset").replaceChildren(...datasets.map((name) => new Option(name)));
  $("sound").replaceChildren(...sounds.map((name) => new Option(name)), new Option("file"));
  await open(datasets[0]);
})();
