"use strict";
// The page: what is drawn goes to the server, what the server knows of it and where its cars are is shown.

const EXAMPLES = {
  "Right angle": { points: [[-3, -2], [2, -2], [2, 2.6]], widths: [1.4, 1.4], radii: [0] },
  "S-bend": { points: [[-4, -1.2], [-1.2, -1.2], [1.2, 1.2], [4, 1.2]], widths: [1.3, 1.3, 1.3], radii: [2, 2] },
  "Zigzag": { points: [[-5, -0.8], [-2.4, -0.8], [-0.8, 0.8], [0.8, 0.8], [2.4, -0.8], [5, -0.8]], widths: [1.3, 1.3, 1.3, 1.3, 1.3], radii: [0, 0, 0, 0] },
  "U-turn": { points: [[-2.5, -1], [1.5, -1], [1.5, 1], [-4.5, 1]], widths: [1.4, 1.4, 1.4], radii: [1, 1] },
  "Bottleneck": { points: [[-5, 0], [-1.5, 0], [0.5, 0], [4, 0]], widths: [1.6, 0.8, 1.6], radii: [0, 0] },
  "So tight that it takes backing up": { points: [[-2.5, -0.62], [1.5, -0.62], [1.5, 0.63], [-4.5, 0.63]], widths: [1.15, 1.15, 1.15], radii: [0, 0] },
  "No way out": { points: [[-3, -2], [2, -2], [2, 2]], widths: [0.7, 0.7], radii: [0] },
};
const CODES = {
  ArrowUp: "forward", KeyW: "forward", ArrowDown: "reverse", KeyS: "reverse",
  ArrowLeft: "left", KeyA: "left", ArrowRight: "right", KeyD: "right", Space: "stop",
};
const END = {
  success: "out in the open", collision: "hit a wall", false_exit: "open space, but not the exit",
  timeout: "out of time", stall: "stood still for too long",
};
const COLOURS = ["#e8eaed", "#f2994a"];
const POST_MS = 100, MOST_FILE_BYTES = 90000;

const byId = (id) => document.getElementById(id);
const held = new Set();                      // codes of keys and names of pad buttons that are down
let options = null, sitting = null, seat = null, drives = false, lost = false;
let track = null, fetching = false;          // the newest that the server knows
let unsaved = 0;                             // drawings on their way to the server
let view = null, lanes = [], racing = -1;    // per car: the two newest views, when the newest came, and its trail
let chosen = false;                          // whether the person has chosen a driver

const canvas = byId("view"), pen = canvas.getContext("2d");
const editor = new Editor(canvas, {
  may: () => drives,
  fit: async (stroke) => {
    const answer = await post("/fit", { stroke: thinned(stroke), width: editor.width });
    if (answer?.problem) complain(answer.problem);
    return answer?.drawing ?? null;
  },
  changed: (drawing) => send(drawing),
  selected: () => report(),
});

// --- to the server ---
async function post(path, body = {}) {
  if (!seat) return null;
  try {
    const answer = await fetch(path, { method: "POST", body: JSON.stringify({ seat, ...body }), keepalive: path === "/keys" });
    if (answer.ok) return await answer.json();
    if (path !== "/keys") complain({ text: answer.status === 409 ? "Another tab draws; you watch" : await answer.text() });
  } catch { /* the stream says when the connection is lost */ }
  return null;
}
function thinned(stroke) {
  const every = Math.ceil(stroke.length / 2000);
  return stroke.filter((_, i) => i % every === 0 || i === stroke.length - 1).map(([x, y]) => [Number(x.toFixed(3)), Number(y.toFixed(3))]);
}
async function send(drawing) {
  history.replaceState(null, "", drawing ? toHash(drawing) : location.pathname);
  complaint = null;
  unsaved += 1;
  const answer = await post(drawing ? "/draw" : "/clear", drawing ? { drawing } : {});
  unsaved -= 1;
  if (answer) take(answer);
  report();
}
async function open(text) {
  complaint = null;
  const answer = await post("/open", { text });
  if (!answer) return;
  editor.past.push(JSON.stringify(editor.drawing));
  editor.put(answer.drawing);
  history.replaceState(null, "", answer.drawing ? toHash(answer.drawing) : location.pathname);
  take(answer);
  editor.show(extent());
  report();
}
function example(name) {
  editor.commit(structuredClone(EXAMPLES[name]), true);
  editor.show(extent());
}

let complaint = null;  // what a request was refused for
function complain(problem) { complaint = problem; report(); }

function take(answer) {
  if (answer.sitting !== sitting || (track && answer.version < track.version)) return;
  track = answer;
  adviseDriver();
}
async function refresh() {
  if (fetching) return;
  fetching = true;
  try {
    const answer = await (await fetch("/track")).json(), other = !track || answer.number !== track.number;
    if (!unsaved && answer.sitting === sitting) {
      if (other && (!drives || !track)) {  // drawn by another tab, or before this one was loaded
        editor.put(answer.drawing);
        take(answer);
        if (answer.world) editor.show(extent());
      } else take(answer);
    }
  } catch { /* told by the stream */ }
  fetching = false;
  report();
}
function listen() {
  const events = new EventSource("/views");
  events.onmessage = async (message) => {
    const event = JSON.parse(message.data), first = seat === null;
    const again = sitting !== null && event.sitting !== sitting;  // zebrat play was ended and started: it knows no track
    if (again) [track, racing] = [null, -1];
    [sitting, seat, drives, lost] = [event.sitting, event.seat, event.drives, false];
    see(event.view);
    if (again && drives && editor.drawing) await send(editor.drawing);
    else if (first && drives && location.hash) await fromLink();
    else if (!track || event.view.version > track.version) refresh();
    report();
  };
  events.onerror = () => { seat = null; lost = true; report(); };
}
async function fromLink() {
  let drawing = null;
  try { drawing = fromHash(location.hash); } catch { /* told below */ }
  if (!drawing) return complain({ text: "The link holds no drawing" });
  if (JSON.stringify(drawing) === JSON.stringify(editor.drawing)) return;
  const answer = await post("/draw", { drawing });
  if (!answer) return;
  editor.put(answer.drawing);
  take(answer);
  editor.show(extent());
}
function see(now) {
  view = now;
  if (now.race !== racing || now.lanes.length !== lanes.length) {
    racing = now.race;
    lanes = now.lanes.map(() => ({ last: null, now: null, at: 0, trail: [] }));
  }
  now.lanes.forEach((lane, i) => {
    const seen = lanes[i];
    if (!lane.view || (seen.now && seen.now.time_s === lane.view.time_s)) return;
    seen.last = seen.now ?? lane.view;
    seen.now = lane.view;
    seen.at = performance.now();
    seen.trail.push(lane.view.pose);
  });
}

// --- keys and pad ---
const manned = () => Boolean(view?.lanes.some((lane) => lane.agent === options.person && ["building", "ready", "driving"].includes(lane.phase)));
function postKeys() {
  if (!drives || !manned()) return;
  const keys = [...new Set([...held].map((code) => CODES[code] ?? code))];
  for (const button of document.querySelectorAll("#pad button")) button.classList.toggle("down", keys.includes(button.dataset.key));
  post("/keys", { keys, restart: false });
}
function letGo() { held.clear(); postKeys(); }
addEventListener("keydown", (event) => {
  if (event.code === "KeyZ" && (event.ctrlKey || event.metaKey)) { event.preventDefault(); editor.undo(); return; }
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.code === "Delete") editor.remove();
  if (!(event.code in CODES) || !manned()) return;
  event.preventDefault();
  if (!held.has(event.code)) { held.add(event.code); postKeys(); }
});
addEventListener("keyup", (event) => { if (held.delete(event.code)) postKeys(); });
addEventListener("blur", letGo);
document.addEventListener("visibilitychange", () => { if (document.hidden) letGo(); });
setInterval(() => { if (document.hasFocus() || held.size) postKeys(); }, POST_MS);
for (const button of document.querySelectorAll("#pad button")) {
  button.addEventListener("pointerdown", (event) => { event.preventDefault(); button.setPointerCapture(event.pointerId); held.add(button.dataset.key); postKeys(); });
  for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) button.addEventListener(end, () => { if (held.delete(button.dataset.key)) postKeys(); });
  button.addEventListener("contextmenu", (event) => event.preventDefault());
}

// --- the panel ---
byId("tool-free").onclick = () => tool("free");
byId("tool-corner").onclick = () => tool("corner");
function tool(name) {
  editor.tool = name;
  editor.pending = null;
  byId("tool-free").classList.toggle("on", name === "free");
  byId("tool-corner").classList.toggle("on", name === "corner");
  report();
}
byId("snap").onchange = () => { editor.snap = byId("snap").checked; };
byId("undo").onclick = () => editor.undo();
byId("clear").onclick = () => { editor.pending = null; editor.select(null); editor.commit(null); editor.home(); };
byId("remove").onclick = () => editor.remove();
byId("first-example").onclick = () => example(Object.keys(EXAMPLES)[0]);
byId("examples").onchange = (event) => {
  const [kind, name] = event.target.value.split(":");
  event.target.value = "";
  if (kind === "drawing") example(name); else if (kind === "world") open(name);
};
for (const [id, field] of [["width", "widths"], ["radius", "radii"]]) {
  byId(id).oninput = () => { byId(`${id}-m`).textContent = metres(id, Number(byId(id).value)); };
  byId(id).onchange = () => { if (drives) editor.set(field, Number(byId(id).value)); };
}
byId("cancel").onclick = () => post("/cancel");
byId("driver").onchange = () => { chosen = true; report(); };
byId("beside").onchange = () => report();
byId("drive").onclick = () => {
  byId("drive").blur();
  complaint = null;
  const agents = [byId("driver").value, byId("beside").value].filter(Boolean);
  post("/drive", { agents, pace: Number(byId("pace").value) });
};
byId("stop").onclick = () => post("/stop");
byId("zoom-in").onclick = () => editor.zoom(1.3);
byId("zoom-out").onclick = () => editor.zoom(1 / 1.3);
byId("zoom-fit").onclick = () => editor.show(extent());
byId("download").onclick = () => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([track.text], { type: "application/yaml" }));
  link.download = `${(track.world?.name ?? "my_track").replace(/[^\w.-]/g, "_")}.yaml`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  byId("shared").textContent = `zebrat evaluate --agent shipped --worlds ${link.download}`;
};
byId("link").onclick = async () => {
  const link = location.origin + "/" + toHash(editor.drawing);
  try { await navigator.clipboard.writeText(link); byId("shared").textContent = "Copied: it opens wherever zebrat play runs"; }
  catch { byId("shared").textContent = link; }
};
byId("open").onclick = () => byId("file").click();
byId("file").onchange = () => { read(byId("file").files[0]); byId("file").value = ""; };
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => { event.preventDefault(); read(event.dataTransfer.files[0]); });
async function read(file) {
  if (!file) return;
  if (file.size > MOST_FILE_BYTES) return complain({ text: `${file.name} holds ${Math.round(file.size / 1000)} kB: a world file for this page holds at most ${MOST_FILE_BYTES / 1000} kB` });
  open(await file.text());
}

function metres(id, value) { return id === "radius" && value === 0 ? "sharp" : `${value.toFixed(id === "width" ? 2 : 1)} m`; }
function say(id, text, kind = "") { if (byId(id).textContent !== text) byId(id).textContent = text; byId(id).className = kind; }

// Where reversing is needed, the driver that has learned it is proposed; unless the person has chosen.
function adviseDriver() {
  if (chosen || track.finding?.state !== "drivable" || !options.drivers.some((driver) => driver.name === "allround")) return;
  byId("driver").value = track.finding.n_reversals > 0 ? "allround" : options.first;
}

function report() {
  if (!options) return;
  const { drawing, selection } = editor, problem = complaint ?? track?.problem ?? null;
  const world = unsaved ? null : track?.world ?? null, finding = track?.finding;
  byId("hint").hidden = Boolean(drawing || editor.pending || editor.stroke || world || problem) || !drives;
  if (lost) say("check", "Connection lost; is zebrat play still running?", "bad");
  else if (!seat) say("check", "Connecting…");
  else if (!drives) say("check", "Another tab draws; you watch.", "unsure");
  else if (problem) say("check", problem.text, "bad");
  else if (editor.pending) say("check", "Tap where the next corner is.");
  else if (unsaved || fetching) say("check", "Checking…");
  else if (world) say("check", `✔ A passage that the car fits into. ${track.note}`.trim(), "good");
  else say("check", "Nothing is drawn yet.");
  byId("check").title = problem?.details ?? "";

  const kinds = { drivable: "good", no_way: "bad", gave_up: "unsure", cancelled: "unsure", searching: "", unasked: "" };
  const marks = { drivable: "✔ ", no_way: "✖ ", gave_up: "? ", cancelled: "? ", searching: "… ", unasked: "" };
  if (world && finding && !problem) {
    const more = finding.state === "drivable" ? `: ${finding.length_m.toFixed(1)} m, in no less than ${finding.least_time_s.toFixed(1)} s, ${(100 * finding.clearance_m).toFixed(1)} cm from the walls.` : "";
    say("finding", marks[finding.state] + finding.text + more, kinds[finding.state]);
  } else say("finding", "");
  byId("cancel").hidden = !(world && finding?.state === "searching") || !drives;

  const running = Boolean(view?.lanes.some((lane) => ["building", "ready", "driving"].includes(lane.phase)));
  byId("drive").disabled = !world || !drives || Boolean(track?.problem);
  byId("drive").textContent = view?.lanes.length ? "▶ Again" : "▶ Drive";
  byId("drive").hidden = running || (!drawing && !world) || !drives;
  byId("stop").hidden = !running || !drives;
  byId("pace").hidden = byId("drive").hidden || byId("beside").value === options.person;
  byId("how").hidden = !drawing || !drives;
  byId("about").textContent = [byId("driver").value, byId("beside").value]
    .map((name) => options.drivers.find((driver) => driver.name === name)).filter(Boolean)
    .map(({ name, text }) => `${short(name)}: ${text}.`).join(" ");
  byId("download").disabled = !track?.text || !world;
  byId("link").disabled = !drawing;
  byId("remove").hidden = selection?.corner === undefined || !drawing;
  byId("pad").classList.toggle("shown", manned() && drives);

  const leg = selection?.leg, corner = selection?.corner;
  byId("width-of").textContent = leg === undefined ? "" : "of one leg";
  byId("radius-of").textContent = corner === undefined ? "" : "of one corner";
  const one = corner > 0 && corner <= (drawing?.radii.length ?? 0) ? drawing.radii[corner - 1] : editor.radius;
  if (document.activeElement !== byId("width")) byId("width").value = leg === undefined ? editor.width : drawing.widths[leg];
  if (document.activeElement !== byId("radius")) byId("radius").value = one;
  for (const id of ["width", "radius"]) byId(`${id}-m`).textContent = metres(id, Number(byId(id).value));
  const step = world ? 2 : drawing ? 1 : 0;
  document.querySelectorAll("h2").forEach((h, i) => h.classList.toggle("now", i === step));
  reportLanes();
}

const short = (agent) => agent.split("/").pop();  // a policy file goes by its name
function told(lane) {
  if (lane.phase === "building") return ["gets ready", ""];
  if (lane.phase === "ready") return [manned() ? "waits for the first key" : "gets ready", ""];
  if (lane.phase === "driving") return [`${lane.time_s.toFixed(1)} s`, ""];
  if (lane.phase === "stopped") return ["stopped", "unsure"];
  if (lane.phase === "failed") return [lane.text, "bad"];
  return [`${END[lane.outcome] ?? lane.outcome} after ${lane.time_s.toFixed(1)} s`, lane.outcome === "success" ? "good" : "bad"];
}
function reportLanes() {
  const list = byId("lanes"), shown = view?.lanes ?? [];
  while (list.children.length > shown.length) list.lastChild.remove();
  while (list.children.length < shown.length) {
    const row = list.appendChild(document.createElement("li"));
    row.append(document.createElement("i"), document.createElement("span"), document.createElement("span"));
  }
  shown.forEach((lane, i) => {
    const [dot, name, state] = list.children[i].children, [text, kind] = told(lane);
    dot.style.background = COLOURS[i];
    name.textContent = short(lane.agent);
    [state.textContent, state.className] = [text, kind];
  });
  let banner = "";
  if (shown.some((lane) => lane.phase === "ready") && manned()) banner = "Press ↑ (or ▲): both cars start. Steer with ← →";
  else if (shown.length && shown.every((lane) => lane.phase === "over")) banner = shown.map((lane) => `${short(lane.agent)}: ${told(lane)[0]}`).join("\n");
  else if (shown.some((lane) => lane.phase === "building")) banner = "The car is put on the track…";
  say("banner", banner);
}

fetch("/options").then((answer) => answer.json()).then((json) => {
  options = json;
  const add = (id, value, text, group) => {
    const option = document.createElement("option");
    [option.value, option.textContent] = [value, text];
    (group ?? byId(id)).append(option);
  };
  for (const { name } of options.drivers) add("driver", name, short(name));
  byId("driver").value = options.first;
  add("beside", "", "nobody");
  add("beside", options.person, "you (arrow keys or pad)");
  for (const { name } of options.drivers) add("beside", name, short(name));
  for (const pace of options.paces) add("pace", pace, `${pace}× speed`);
  for (const name of Object.keys(EXAMPLES)) add("examples", `drawing:${name}`, name);
  const worlds = document.createElement("optgroup");
  worlds.label = "Shipped worlds";
  for (const name of options.worlds) add("", `world:${name}`, name, worlds);
  byId("examples").append(worlds);
  editor.home();
  report();
  listen();
  paint();
});
