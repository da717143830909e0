"use strict";
// The page of a scene that is simulated while one listens. A question is two places and absorption; its answers come
// one after the other, each better, and each is drawn and heard when it comes.

const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b8860b", "#56b4e9", "#7b3294", "#1b7837", "#b2182b", "#4d4d4d", "#e69f00", "#2166ac"];
const STEP_M = 0.25, TURN = 5, SOON_MS = 120; // of an arrow key; of a key that turns, degrees; between questions while something moves
const STEP_UP = 0.05; // m by which heights of neighbouring cells differ at an edge
const NEAR = 18; // px about a mark that can be dragged
const KINDS = { estimate: "", moved: "walking: reverberation of the place before", counts: "read from counts of reflections",
  preview: "first sound, without early reflections" };
const state = { scene: null, source: null, listener: null, heading: 90, storey: 0, chosen: {}, answer: null, cut: null, slot: "a", slots: {}, floors: {} };
let asking = null, timer = 0, heard = 0;

// ---- questions -------------------------------------------------------------------------------------------------------

function query() {
  const place = (p) => [p[0].toFixed(3), p[1].toFixed(3), p[2]].join(",");
  const m = Object.entries(state.chosen).map(([row, { values }]) => `${row}~${values.map((a) => +a.toFixed(4)).join(":")}`).join(",");
  return `s=${place(state.source)}&l=${place(state.listener)}&m=${m}`;
}

const complain = (error) => { if (error && error.name !== "AbortError") $("problem").textContent = `${error.message || error}`; };
const guarded = (action) => (...given) => { $("problem").textContent = ""; return Promise.resolve(action(...given)).catch(complain); };

async function json(path, signal) {
  const answer = await fetch(path, { signal });
  const content = await answer.json();
  if (!answer.ok) throw new Error(content.error || `${answer.status}`);
  return content;
}

// Ask, and go on until the last estimate is there, or something else is asked.
async function follow() {
  if (asking) asking.abort();
  const mine = asking = new AbortController();
  const asked = query();
  let version = -1;
  while (asking === mine) {
    const answer = await json(`api/pair?${asked}&after=${version}`, mine.signal);
    if (answer.waiting) { $("progress-text").textContent = answer.waiting; continue; }
    if (asking !== mine) return;
    if (answer.version !== version) {
      version = answer.version;
      state.answer = answer;
      document.body.dataset.version = version;
      draw();
      await listen();
    }
    if (answer.note) $("progress-text").textContent = `${KINDS.preview[0].toUpperCase()}${KINDS.preview.slice(1)}. ${answer.note}`;
    if (answer.done) {
      if (asked === query()) document.body.dataset.done = asked; // else something has moved meanwhile, and is asked soon
      return;
    }
  }
}

// While something moves questions follow each other at most that often, and the last one is asked.
function changed(soon = false) {
  delete document.body.dataset.done;
  $("problem").textContent = "";
  drawPlan();
  if (!soon) { clearTimeout(timer); timer = 0; follow().catch(complain); return; }
  if (!timer) timer = setTimeout(() => { timer = 0; follow().catch(complain); }, SOON_MS);
}

async function askCut() {
  const y = state.listener[1];
  const found = await json(`api/cut?y=${y.toFixed(3)}`);
  if (Math.abs(state.listener[1] - y) < 1e-6) { state.cut = found; drawCut(); }
}

// What one sees of the storey from above, as a picture: materials pale, and edges where the height jumps.
async function askFloor() {
  const { storey } = state;
  if (state.floors[storey]) { drawPlan(); return; }
  const all = new Float32Array(await (await get(`api/floor?storey=${storey}`)).arrayBuffer());
  const [cell, across, deep] = all, n = across * deep, material = all.subarray(3, 3 + n), height = all.subarray(3 + n);
  const picture = Object.assign(document.createElement("canvas"), { width: across, height: deep }), pen = picture.getContext("2d");
  const dots = pen.createImageData(across, deep), pale = new Map();
  const edge = (k, other) => material[k] !== material[other] || Math.abs(height[k] - height[other]) > STEP_UP;
  for (let k = 0; k < n; k++) {
    if (material[k] < 0) continue;
    if (!pale.has(material[k])) { pen.fillStyle = colourOf(material[k]); pale.set(material[k], [1, 3, 5].map((c) => parseInt(pen.fillStyle.slice(c, c + 2), 16))); }
    const strong = (k % across && edge(k, k - 1)) || (k >= across && edge(k, k - across)) ? 0.55 : 0.16;
    const at = 4 * ((deep - 1 - Math.floor(k / across)) * across + k % across); // pictures begin at the top
    pale.get(material[k]).forEach((c, i) => { dots.data[at + i] = 255 - strong * (255 - c); });
    dots.data[at + 3] = 255;
  }
  pen.putImageData(dots, 0, 0);
  state.floors[storey] = { picture, size: [cell * across, cell * deep] };
  drawPlan();
}

function drawFloor(pen, { scale, low, at }) {
  const floor = state.floors[state.storey];
  if (!floor) return;
  const [width, deep] = floor.size.map((m) => m * scale), [x, y] = at(low);
  pen.drawImage(floor.picture, x, y - deep, width, deep);
}

// ---- sound: input -> the convolver of the answer, cross-faded with the one before -> volume -> meter, ears -----------

const audio = { context: null, input: null, volume: null, now: null, playing: null, meters: [], own: null };

async function start() {
  if (!audio.context) {
    audio.context = new AudioContext({ sampleRate: state.scene.rate });
    audio.input = new GainNode(audio.context);
    audio.volume = new GainNode(audio.context, { gain: Number($("volume").value), channelCount: 2, channelCountMode: "explicit" });
    audio.volume.connect(audio.context.destination);
    const split = new ChannelSplitterNode(audio.context, { numberOfOutputs: 2 });
    audio.volume.connect(split);
    audio.meters = [0, 1].map((ear) => { const node = new AnalyserNode(audio.context, { fftSize: 2048 }); split.connect(node, ear); return node; });
  }
  await resumed(audio.context);
}

async function response() {
  return split(new Float32Array(await (await get(`api/response?${query()}&heading=${state.heading}`)).arrayBuffer()));
}

async function listen() {
  if (!audio.context || !state.answer) return;
  const mine = ++heard;
  const channels = await response();
  if (mine !== heard) return; // something later is heard already
  audio.now = crossfaded(audio.context, audio.input, audio.volume, channels, audio.now);
  document.body.dataset.heard = state.answer.version;
}

function stop() {
  if (audio.playing) { audio.playing.stop(); audio.playing.disconnect(); audio.playing = null; }
  $("play").setAttribute("aria-pressed", "false"); $("play").textContent = "Play";
}

async function dry() {
  if ($("sound").value === "own file" && audio.own) return monoOf(audio.context, audio.own);
  return new Float32Array(await (await get(`api/sound?name=${$("sound").value}`)).arrayBuffer());
}

async function play() {
  await start();
  const [samples] = await Promise.all([dry(), audio.now ? null : listen()]);
  stop();
  audio.playing = new AudioBufferSourceNode(audio.context, { buffer: buffer(audio.context, [samples]), loop: true });
  audio.playing.connect(audio.input);
  audio.playing.start();
  $("play").setAttribute("aria-pressed", "true"); $("play").textContent = "Stop";
  document.body.dataset.playing = performance.now().toFixed(0);
}

const toggle = guarded(async () => { if (audio.playing) stop(); else await play(); });

const takeFile = guarded(async (file) => {
  if (!file) return;
  audio.own = file;
  $("sound").value = "own file";
  await play();
});

// The same nodes off line, for tests.
window.liveRender = async (samples) => {
  const channels = await response();
  const context = new OfflineAudioContext(2, samples.length + channels[0].length, state.scene.rate);
  const node = new AudioBufferSourceNode(context, { buffer: buffer(context, [Float32Array.from(samples)]) });
  node.connect(ears(context, channels)).connect(context.destination);
  node.start();
  const out = await context.startRendering();
  return [0, 1].map((ear) => Array.from(out.getChannelData(ear)));
};

function drawMeter() {
  const [pen, width, height] = canvas("meter"), low = -60, left = 46;
  const x = (db) => left + (width - left - 14) * (Math.max(db, low) - low) / -low;
  pen.clearRect(0, 0, width, height);
  ["left", "right"].forEach((name, ear) => {
    const top = 4 + 13 * ear;
    label(pen, name, left - 6, top + 5, "right");
    pen.fillStyle = "#eee"; pen.fillRect(left, top, width - left - 14, 10);
    if (!audio.meters.length) return;
    const samples = new Float32Array(audio.meters[ear].fftSize);
    audio.meters[ear].getFloatTimeDomainData(samples);
    const peak = samples.reduce((most, s) => Math.max(most, Math.abs(s)), 0), db = 20 * Math.log10(peak || 1e-9);
    pen.fillStyle = db > -0.1 ? "#d55e00" : db > -6 ? "#e69f00" : "#009e73"; pen.fillRect(left, top, x(db) - left, 10);
  });
  for (let db = low; db < 0; db += 20) label(pen, minus(db), x(db), 36);
  label(pen, "0 dBFS", x(0) + 10, 36, "right");
}

function meter() { if (audio.playing) drawMeter(); requestAnimationFrame(meter); }

// ---- plan and section ------------------------------------------------------------------------------------------------

function colourOf(row) { // past the colours by name the hue turns by the golden angle
  const k = state.scene.materials.findIndex((m) => m.row === row);
  return COLOURS[k] || `hsl(${(137.5 * k) % 360}, 60%, ${k % 2 ? 35 : 50}%)`;
}
const planView = (width, height) => fitted(state.scene.low, state.scene.high, width, height, 20);

function drawLines(pen, lines, at) {
  pen.lineWidth = 2;
  for (const [row, u0, v0, u1, v1] of lines) {
    pen.strokeStyle = colourOf(row); pen.beginPath(); pen.moveTo(...at([u0, v0])); pen.lineTo(...at([u1, v1])); pen.stroke();
  }
}

function drawPlan() {
  if (state.scene) shaped("plan", state.scene.low, state.scene.high, 20);
  const [pen, width, height] = canvas("plan");
  pen.clearRect(0, 0, width, height);
  if (!state.scene) return;
  const seen = planView(width, height), { at } = seen;
  drawFloor(pen, seen);
  drawAxes(pen, seen);
  pen.fillStyle = "#aab4bc";
  for (const p of state.scene.points[state.storey]) { const [x, y] = at(p); pen.fillRect(x - 1, y - 1, 2, 2); }
  drawLines(pen, state.scene.plans[state.storey], at);
  if (state.listener[2] === state.storey) {
    pen.setLineDash([2, 5]); pen.strokeStyle = "#999"; pen.lineWidth = 1; pen.beginPath();
    pen.moveTo(...at([seen.low[0], state.listener[1]])); pen.lineTo(...at([seen.high[0], state.listener[1]])); pen.stroke(); pen.setLineDash([]);
    head(pen, ...at(state.listener), state.heading);
  }
  if (state.source[2] === state.storey) star(pen, ...at(state.source));
}

function drawCut() {
  if (state.scene) shaped("cut", [state.scene.low[0], state.scene.low[2]], [state.scene.high[0], state.scene.high[2]], 20);
  const [pen, width, height] = canvas("cut");
  pen.clearRect(0, 0, width, height);
  if (!state.cut) return;
  const { low, high, heights } = state.scene, seen = fitted([low[0], low[2]], [high[0], high[2]], width, height, 20);
  drawAxes(pen, seen, ["x (m)", "z (m)"]);
  drawLines(pen, state.cut.lines, seen.at);
  head(pen, ...seen.at([state.listener[0], heights[state.listener[2]]]), Math.cos(state.heading * Math.PI / 180) < 0 ? 180 : 0);
  pen.globalAlpha = Math.abs(state.source[1] - state.cut.y) < STEP_M ? 1 : 0.35; // it stands before the section, or behind
  star(pen, ...seen.at([state.source[0], heights[state.source[2]]]));
  pen.globalAlpha = 1;
  label(pen, `Section at y = ${minus(state.cut.y.toFixed(2))} m`, width - 20, 12, "right");
}

// ---- numbers ---------------------------------------------------------------------------------------------------------

const bandName = (b) => bandText(state.scene.bands[b], state.scene.bands[b + 1]);
// With no more digits than its error leaves meaning to.
function withError([value, error], most) {
  if (value === null) return "–";
  const digits = error ? Math.max(Math.min(Math.ceil(-Math.log10(2 * error)), most), 0) : most;
  return `${number(value, digits)} ± ${error === null ? "?" : number(2 * error, digits)}`;
}

function drawMeasures() {
  const [pen, width, height] = canvas("bars");
  pen.clearRect(0, 0, width, height);
  if (!state.answer) return;
  [["t30", "T30 (s)"], ["c50", "C50 (dB)"]].forEach(([name, title], k) => {
    const values = state.answer.measures[name], half = width / 2, left = half * k + 52, right = half * (k + 1) - 12, top = 16, bottom = height - 34;
    const ends = values.filter(([v]) => v !== null).flatMap(([v, e]) => [v - 2 * (e || 0), v + 2 * (e || 0)]);
    label(pen, title, left - 40, (top + bottom) / 2, "center", true);
    pen.strokeStyle = "#999"; pen.lineWidth = 1; pen.strokeRect(left, top, right - left, bottom - top);
    label(pen, "band", (left + right) / 2, height - 8);
    values.forEach((_, b) => label(pen, `${b + 1}`, left + (right - left) * (b + 0.5) / values.length, bottom + 12));
    if (!ends.length) { label(pen, "not known yet", (left + right) / 2, (top + bottom) / 2); return; }
    const pad = 0.15 * Math.max(Math.max(...ends) - Math.min(...ends), name === "t30" ? 0.1 : 2);
    const low = Math.min(...ends) - pad, high = Math.max(...ends) + pad, y = (v) => bottom - (bottom - top) * (v - low) / (high - low);
    const step = round((high - low) / 4), digits = Math.max(Math.ceil(-Math.log10(step) - 1e-9), 0);
    for (const v of ticks(low, high, step)) {
      pen.strokeStyle = "#eee"; pen.beginPath(); pen.moveTo(left, y(v)); pen.lineTo(right, y(v)); pen.stroke();
      label(pen, minus((+v.toFixed(digits) + 0).toFixed(digits)), left - 5, y(v), "right");
    }
    values.forEach(([v, e], b) => {
      if (v === null) return;
      const x = left + (right - left) * (b + 0.5) / values.length;
      pen.strokeStyle = pen.fillStyle = BANDS[b % BANDS.length]; pen.lineWidth = 2;
      if (e !== null) {
        pen.beginPath(); pen.moveTo(x, y(v - 2 * e)); pen.lineTo(x, y(v + 2 * e));
        for (const end of [v - 2 * e, v + 2 * e]) { pen.moveTo(x - 5, y(end)); pen.lineTo(x + 5, y(end)); }
        pen.stroke();
      }
      pen.beginPath(); pen.arc(x, y(v), 3.5, 0, 7); if (e === null) pen.stroke(); else pen.fill();
    });
  });
}

function tell() {
  const p = state.answer, { steps } = state.scene;
  if (!p) return;
  $("pair").textContent = `${p.distance.toFixed(2)} m apart, ${p.visible ? "in sight" : "out of sight"}, ${p.arrivals.length} discrete arrivals` +
    (p.level === null ? "" : `, level ${number(p.level, 1)} dB re the direct sound at 1 m`) + `. Speech transmission index ${withError(p.measures.sti[0], 3)}.`;
  $("progress").max = steps.length; $("progress").value = p.kind === "estimate" ? p.step + 1 : 0;
  $("progress-text").textContent = p.kind === "estimate" ? `Estimate ${p.step + 1} of ${steps.length}: ${steps[p.step].toLocaleString("en")} subpaths a point${p.done ? "" : ", sharpening …"}`
    : `${KINDS[p.kind][0].toUpperCase()}${KINDS[p.kind].slice(1)}; simulating …`;
  const table = $("numbers"), { t30, c50 } = p.measures;
  const rows = p.decay.map((_, b) => [`${b + 1}: ${bandName(b)}`, withError(t30[b], 3), withError(c50[b], 2), percent(p.error[0][b]), percent(p.error[1][b])]);
  table.replaceChildren();
  table.createCaption().textContent = "± two standard errors. “?”, and an open circle: error not known yet. “–”: not known.";
  for (const cells of [["Band", "T30 (s)", "C50 (dB)", "± of energy to 80 ms", "± of later energy"], ...rows]) {
    const tr = table.insertRow();
    if (cells[0] === "Band") tr.className = "names";
    cells.forEach((text, k) => tr.append(Object.assign(document.createElement(k && cells[0] !== "Band" ? "td" : "th"), { textContent: text })));
  }
}

const percent = (e) => e === null ? "?" : `${(200 * e).toFixed(1)} %`;

function draw() { drawPlan(); drawMeasures(); tell(); }

// ---- materials -------------------------------------------------------------------------------------------------------

const mean = (values) => values.reduce((a, b) => a + b, 0) / values.length;

function drawMaterials() {
  const table = $("materials");
  table.replaceChildren();
  const names = Object.keys(state.scene.table);
  for (const m of state.scene.materials) {
    const tr = table.insertRow(), chosen = state.chosen[m.row], first = document.createElement("th");
    const swatch = Object.assign(document.createElement("span"), { className: "swatch" });
    swatch.style.background = colourOf(m.row);
    first.append(swatch, m.name);
    first.title = `${m.area} m²: ${m.labels.join(", ") || "no labels"}`;
    const slider = Object.assign(document.createElement("input"), { type: "range", min: 0, max: 0.99, step: 0.01, value: mean(chosen ? chosen.values : m.absorption), disabled: m.fixed });
    slider.setAttribute("aria-label", `Absorption of ${m.name}`);
    const shown = Object.assign(document.createElement("output"), { textContent: (+slider.value).toFixed(2) });
    const other = document.createElement("select");
    other.setAttribute("aria-label", `${m.name} absorbs like`);
    other.append(new Option("its own", ""), new Option("slider", "slider"), ...names.filter((n) => n !== m.name).map((n) => new Option(n)));
    other.value = chosen ? chosen.like : "";
    other.disabled = m.fixed;
    slider.addEventListener("input", () => {
      shown.textContent = (+slider.value).toFixed(2); other.value = "slider";
      state.chosen[m.row] = { like: "slider", values: m.absorption.map(() => +slider.value) };
      changed(true);
    });
    other.addEventListener("change", () => {
      if (!other.value) delete state.chosen[m.row];
      else state.chosen[m.row] = { like: other.value, values: other.value === "slider" ? m.absorption.map(() => +slider.value) : state.scene.table[other.value] };
      slider.value = mean(state.chosen[m.row] ? state.chosen[m.row].values : m.absorption); shown.textContent = (+slider.value).toFixed(2);
      changed();
    });
    for (const [cell, parts] of [["td", [slider, shown]], ["td", [other]]]) { const td = document.createElement(cell); td.append(...parts); tr.append(td); }
    tr.prepend(first);
  }
}

// ---- two states ------------------------------------------------------------------------------------------------------

const copyOf = () => structuredClone({ source: state.source, listener: state.listener, chosen: state.chosen, heading: state.heading });

function take(slot) {
  if (slot === state.slot) return;
  state.slots[state.slot] = copyOf();
  Object.assign(state, structuredClone(state.slots[slot] || state.slots[state.slot]), { slot });
  for (const name of ["a", "b"]) $(`state-${name}`).setAttribute("aria-pressed", `${name === slot}`);
  drawMaterials(); turned(); moved();
}

// ---- the dataset -----------------------------------------------------------------------------------------------------

const line = (tag, text) => Object.assign(document.createElement(tag), { textContent: text });

async function makeJob() {
  const answer = await fetch(`api/job?${query()}&spacing=${Number($("spacing").value)}`, { method: "POST" });
  const job = await answer.json();
  if (!answer.ok) throw new Error(job.error);
  $("job").replaceChildren(line("p", `Wrote ${job.files.join(" and ")}. This command makes the dataset:`), line("pre", job.command), line("p", "Measuring how long it will take …"));
  for (;;) {
    const f = await json("api/forecast");
    if (f.state === "measuring") { await new Promise((go) => setTimeout(go, 1000)); continue; }
    $("job").lastChild.textContent = f.state === "known"
      ? `Forecast: ${f.pairs.toLocaleString("en")} responses between ${f.points.toLocaleString("en")} points, ${(f.bytes / 1e6).toFixed(0)} MB, ` +
        `at most ${(60 * f.core_hours).toFixed(1)} minutes of one core.`
      : `No forecast: ${(f.why || []).join(" ")}`;
    return;
  }
}

// ---- what people do --------------------------------------------------------------------------------------------------

function turned() { $("heading").value = state.heading; $("heading-text").textContent = `${minus(state.heading)}°`; drawPlan(); drawCut(); }
const turn = (to) => { state.heading = (((to + 180) % 360) + 360) % 360 - 180; turned(); listen().catch(complain); };
const decibels = (gain) => gain > 0 ? `${minus((20 * Math.log10(gain)).toFixed(0))} dB` : "off";
function setVolume() {
  const gain = Number($("volume").value);
  $("volume-text").textContent = decibels(gain);
  if (audio.volume) audio.volume.gain.value = gain;
}
function moved(soon = false) { changed(soon); askCut().catch(complain); }
function walk(end, dx, dy) { const p = state[end]; state[end] = [p[0] + dx, p[1] + dy, p[2]]; moved(true); }

function wire() {
  const plan = $("plan");
  let dragged = null;
  const place = (event) => { const box = plan.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
  plan.addEventListener("pointerdown", (event) => {
    if (!state.scene) return;
    plan.focus();
    const { at, back } = planView(plan.clientWidth, plan.clientHeight), [x, y] = place(event);
    const near = (end) => { const [px, py] = at(state[end]); return state[end][2] === state.storey ? Math.hypot(px - x, py - y) : Infinity; };
    const ends = ["listener", "source"].sort((a, b) => near(a) - near(b));
    const other = event.shiftKey || event.button === 2 || $("place-source").checked ? "source" : "listener";
    dragged = near(ends[0]) < NEAR ? ends[0] : other;
    plan.setPointerCapture(event.pointerId);
    if (near(dragged) >= NEAR) { state[dragged] = [...back(x, y), state.storey]; moved(); }
    if (!audio.playing) guarded(play)(); // a click is what a browser wants before it plays
  });
  plan.addEventListener("pointermove", (event) => {
    if (!dragged) return;
    state[dragged] = [...planView(plan.clientWidth, plan.clientHeight).back(...place(event)), state.storey];
    moved(true);
  });
  for (const end of ["pointerup", "pointercancel"]) plan.addEventListener(end, () => { dragged = null; });
  plan.addEventListener("contextmenu", (event) => event.preventDefault());
  document.addEventListener("keydown", (event) => {
    if (!state.scene || ["SELECT", "INPUT"].includes(event.target.tagName) || event.ctrlKey || event.metaKey || event.altKey) return;
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (way) walk(event.shiftKey ? "source" : "listener", way[0] * STEP_M, way[1] * STEP_M);
    else if (event.key === "," || event.key === "<") turn(state.heading + TURN);
    else if (event.key === "." || event.key === ">") turn(state.heading - TURN);
    else if (event.key === " " && event.target.tagName !== "BUTTON") toggle();
    else if (event.key === "a" || event.key === "b") take(event.key);
    else return;
    event.preventDefault();
  });
  $("heading").addEventListener("input", () => turn(Number($("heading").value)));
  $("storey").addEventListener("change", () => { state.storey = Number($("storey").value); drawPlan(); askFloor().catch(complain); });
  $("play").addEventListener("click", toggle);
  $("sound").addEventListener("change", guarded(async () => { if (audio.playing) await play(); }));
  $("file").addEventListener("change", () => takeFile($("file").files[0]));
  $("volume").addEventListener("input", setVolume);
  $("state-a").addEventListener("click", () => take("a"));
  $("state-b").addEventListener("click", () => take("b"));
  $("make").addEventListener("click", guarded(makeJob));
  document.addEventListener("dragover", (event) => event.preventDefault());
  document.addEventListener("drop", (event) => { event.preventDefault(); takeFile(event.dataTransfer.files[0]); });
  window.addEventListener("resize", () => { if (state.scene) { draw(); drawCut(); drawMeter(); } });
}

guarded(async () => {
  const [scene, { sounds }] = await Promise.all([json("api/scene"), json("api/sounds")]);
  Object.assign(state, { scene, storey: scene.storey, source: [scene.source[0], scene.source[1], scene.storey], listener: [scene.listener[0], scene.listener[1], scene.storey] });
  state.heading = Math.round(Math.atan2(state.source[1] - state.listener[1], state.source[0] - state.listener[0]) * 180 / Math.PI / TURN) * TURN;
  $("title").textContent = scene.name;
  $("progress-text").textContent = "Making the first estimate …";
  $("sound").replaceChildren(...sounds.map((name) => new Option(name)), new Option("own file"));
  $("storey").replaceChildren(...scene.plans.map((_, k) => new Option(`${k + 1}`, k, false, k === state.storey)));
  $("storey-label").hidden = scene.plans.length < 2;
  const areas = scene.materials.map((m) => `${m.name}: ${m.area} m² of ${m.labels.join(", ") || "what has no label"}`);
  $("notes").replaceChildren(...[...areas, ...scene.notes].map((text) => line("li", text)));
  wire(); drawMaterials(); turned(); setVolume(); drawMeter(); moved(); meter();
  askFloor().catch(complain);
  document.body.dataset.ready = scene.name;
})();
