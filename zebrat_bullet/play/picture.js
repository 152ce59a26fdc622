"use strict";
// The picture: grid, passage, way out, cars, and what is being drawn.

function worldToPage([x, y]) {
  const [ox, oy, yaw] = track.origin, [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return [ox + c * x - s * y, oy + s * x + c * y];
}
function extent() {
  if (editor.drawing) return editor.drawing.points;
  return track?.world ? track.world.floor.map(worldToPage) : [];
}

function drawGrid(pixel) {
  const [x0, y0] = editor.metres([0, canvas.clientHeight]), [x1, y1] = editor.metres([canvas.clientWidth, 0]);
  const step = editor.snap && editor.view.scale > 20 ? GRID_M : editor.view.scale > 14 ? 1 : 5;
  pen.strokeStyle = "#1f252d";
  pen.lineWidth = pixel;
  pen.beginPath();
  for (let x = Math.ceil(x0 / step) * step; x < x1; x += step) { pen.moveTo(x, y0); pen.lineTo(x, y1); }
  for (let y = Math.ceil(y0 / step) * step; y < y1; y += step) { pen.moveTo(x0, y); pen.lineTo(x1, y); }
  pen.stroke();
}
function drawPlan(drawing, colour) {  // as wide as it is drawn, before the server has made walls of it
  pen.strokeStyle = colour;
  pen.lineJoin = pen.lineCap = "round";
  drawing.widths.forEach((width, i) => {
    pen.lineWidth = width;
    pen.beginPath();
    trace(pen, [drawing.points[i], drawing.points[i + 1]]);
    pen.stroke();
  });
}
function drawWorld(pixel) {
  const { world, finding } = track;
  pen.save();
  toFrame(pen, track.origin);
  pen.fillStyle = "#262d37";
  pen.beginPath();
  trace(pen, world.floor, true);
  pen.fill();
  drawWalls(pen, world.walls, "#7d889a");
  pen.strokeStyle = pen.fillStyle = "#6fd08c";
  for (const line of [...(world.open_line ? [world.open_line] : []), ...world.gates]) {  // a point is a gate of no length
    pen.lineWidth = 3 * pixel;
    pen.setLineDash([0.12, 0.12]);
    pen.beginPath();
    trace(pen, line);
    pen.stroke();
    if (line[0][0] !== line[1][0] || line[0][1] !== line[1][1]) continue;
    pen.beginPath();
    pen.arc(...line[0], 0.15, 0, 2 * Math.PI);
    pen.fill();
  }
  if (finding?.path.length) {
    pen.strokeStyle = "#3d7effaa";
    pen.lineWidth = 1.5 * pixel;
    pen.setLineDash([0.15, 0.1]);
    pen.beginPath();
    trace(pen, finding.path);
    pen.stroke();
  }
  pen.setLineDash([]);
  pen.restore();
}
function drawGhost(pose, pixel) {  // where the car will begin
  const [length, width] = options.car_m;
  pen.save();
  toFrame(pen, pose);
  pen.strokeStyle = "#e8eaed";
  pen.lineWidth = 2 * pixel;
  pen.strokeRect(-length / 2, -width / 2, length, width);
  pen.beginPath();
  trace(pen, [[length * 0.15, -width / 4], [length * 0.38, 0], [length * 0.15, width / 4]]);
  pen.stroke();
  pen.restore();
}
function drawHandles(drawing, pixel) {
  const { leg, corner } = editor.selection ?? {};
  pen.strokeStyle = "#9aa4b277";
  pen.lineWidth = pixel;
  pen.beginPath();
  trace(pen, drawing.points);
  pen.stroke();
  if (leg !== undefined) {
    pen.strokeStyle = "#3d7eff";
    pen.lineWidth = 3 * pixel;
    pen.beginPath();
    trace(pen, [drawing.points[leg], drawing.points[leg + 1]]);
    pen.stroke();
  }
  drawing.points.forEach(([x, y], i) => {
    const end = i === drawing.points.length - 1;
    pen.fillStyle = i === corner ? "#3d7eff" : end ? "#6fd08c" : "#b8c1cd";
    pen.beginPath();
    pen.arc(x, y, (end ? 7 : 5) * pixel, 0, 2 * Math.PI);
    pen.fill();
  });
}
function drawLanes(pixel) {
  pen.save();
  toFrame(pen, track.origin);
  const shown = view.lanes.map((lane, i) => {
    const seen = lanes[i];
    if (!seen?.now) return null;
    const step = lane.car.step_s / view.pace;
    return smoothed(seen.last, seen.now, (performance.now() - seen.at) / (1000 * step));
  });
  for (const i of [1, 0]) {
    if (!shown[i]) continue;
    pen.strokeStyle = `${COLOURS[i]}55`;
    pen.lineWidth = 2 * pixel;
    pen.beginPath();
    trace(pen, lanes[i].trail);
    pen.stroke();
  }
  if (shown[0]) drawScan(pen, view.lanes[0].car, lanes[0].now, pixel);
  for (const i of [1, 0]) if (shown[i]) drawCar(pen, view.lanes[i].car, shown[i], lanes[i].now.steering_rad, pixel, COLOURS[i]);
  pen.restore();
  return shown;
}
// Texts stand upright, so in pixels.
function write(text, at, colour, above = 0) {  // below `at` where `above` is negative
  const ratio = devicePixelRatio || 1, [x, y] = editor.pixels(at);
  pen.save();
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.font = "600 13px system-ui, sans-serif";
  const width = pen.measureText(text).width + 12;
  const left = Math.max(2, Math.min(canvas.clientWidth - width - 2, x - width / 2)), top = Math.max(2, above < 0 ? y - above : y - above - 22);
  pen.fillStyle = "#14171cdd";
  pen.beginPath();
  pen.roundRect(left, top, width, 20, 5);
  pen.fill();
  pen.fillStyle = colour;
  pen.fillText(text, left + 6, top + 14);
  pen.restore();
}
function drawProblem(problem, pixel) {
  pen.strokeStyle = "#ff7b72";
  pen.lineWidth = 3 * pixel;
  pen.beginPath();
  pen.arc(...problem.at, 0.35, 0, 2 * Math.PI);
  pen.stroke();
  write(problem.text.length > 44 ? `${problem.text.split(/[:;,]/)[0]}` : problem.text, problem.at, "#ff7b72", 0.35 / pixel + 4);
}

function paint() {
  requestAnimationFrame(paint);
  const ratio = devicePixelRatio || 1, [w, h] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const { x, y, scale } = editor.view, pixel = 1 / scale;
  pen.setTransform(1, 0, 0, 1, 0, 0);
  pen.clearRect(0, 0, w, h);
  pen.setTransform(ratio * scale, 0, 0, -ratio * scale, w / 2 - ratio * scale * x, h / 2 + ratio * scale * y);
  if (!options) return;
  drawGrid(pixel);
  const drawing = editor.moving ?? editor.drawing, problem = complaint ?? (unsaved ? null : track?.problem);
  const world = track?.world && !unsaved && !editor.moving && !(editor.stroke && editor.dragged && !editor.extends) ? track.world : null;
  if (world) drawWorld(pixel);
  else if (drawing && !(editor.stroke && editor.dragged && !editor.extends)) drawPlan(drawing, problem ? "#4a2a2e" : "#262d37");
  const racers = world && view?.lanes.length ? drawLanes(pixel) : [];
  const busy = racers.some(Boolean) && view.lanes.some((lane) => ["ready", "driving"].includes(lane.phase));
  if (drawing && !busy && !(editor.stroke && editor.dragged && !editor.extends)) {
    if (!racers.some(Boolean)) {
      const [[ax, ay], [bx, by]] = drawing.points;
      drawGhost([ax, ay, Math.atan2(by - ay, bx - ax)], pixel);
    }
    if (drives) drawHandles(drawing, pixel);
    const end = drawing.points.at(-1);
    write("exit", end, "#6fd08c", 10);
  } else if (world && !racers.some(Boolean)) {
    const [sx, sy, yaw] = world.start;
    drawGhost([...worldToPage([sx, sy]), yaw + track.origin[2]], pixel);
  }
  if (editor.stroke && editor.dragged) {
    if (editor.tool === "free") {
      pen.strokeStyle = "#262d37";
      pen.lineWidth = editor.width;
      pen.lineJoin = pen.lineCap = "round";
      pen.beginPath();
      trace(pen, editor.stroke);
      pen.stroke();
      pen.strokeStyle = "#3d7eff";
      pen.lineWidth = 2.5 * pixel;
      pen.stroke();
    }
  }
  if (editor.pending) {
    pen.fillStyle = "#3d7eff";
    pen.beginPath();
    pen.arc(...editor.pending, 6 * pixel, 0, 2 * Math.PI);
    pen.fill();
  }
  if (problem?.at && !editor.moving && !(editor.stroke && editor.dragged)) drawProblem(problem, pixel);
  racers.forEach((pose, i) => { if (pose) write(short(view.lanes[i].agent), worldToPage(pose), COLOURS[i], (i ? -1 : 1) * (0.5 * scale + 4)); });
}
