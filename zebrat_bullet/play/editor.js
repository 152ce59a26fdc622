"use strict";
// The drawing: corners, the width of each leg, how round each corner is; edited on a canvas by mouse or fingers.
// A drawing is {points: [[x, y], ...], widths: [m of each leg], radii: [m at each corner between two legs]}, in m, y up.

const GRID_M = 0.5, TAP_PX = 7, REACH_PX = { mouse: 12, touch: 24, pen: 16 };

class Editor {
  // `may()`: whether this tab draws; `fit(stroke)`: the drawing that a stroke means; `changed(drawing)`: it is another one now.
  constructor(canvas, { may, fit, changed, selected }) {
    Object.assign(this, { canvas, may, fit, changed, selected });
    this.drawing = null;      // what is there
    this.moving = null;       // the drawing while a corner is dragged
    this.stroke = null;       // where the pen has been
    this.pending = null;      // a first corner without a second
    this.selection = null;    // {leg: i} or {corner: i}
    this.tool = "free";
    this.snap = false;
    this.width = 1.4;
    this.radius = 0.8;
    this.past = [];
    this.view = { x: 0, y: 0, scale: 50 };
    this.pointers = new Map();
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", (event) => this.forget(event));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 500), this.at(event));
    }, { passive: false });
  }

  // --- the view: CSS pixels from the canvas's corner to metres and back ---
  at(event) { const box = this.canvas.getBoundingClientRect(); return this.metres([event.clientX - box.left, event.clientY - box.top]); }
  metres([px, py]) {
    const { x, y, scale } = this.view;
    return [x + (px - this.canvas.clientWidth / 2) / scale, y - (py - this.canvas.clientHeight / 2) / scale];
  }
  pixels([mx, my]) {
    const { x, y, scale } = this.view;
    return [this.canvas.clientWidth / 2 + (mx - x) * scale, this.canvas.clientHeight / 2 - (my - y) * scale];
  }
  zoom(factor, [x, y] = [this.view.x, this.view.y]) {
    const scale = Math.max(4, Math.min(250, this.view.scale * factor)), part = 1 - this.view.scale / scale;
    this.view = { scale, x: this.view.x + (x - this.view.x) * part, y: this.view.y + (y - this.view.y) * part };
  }
  home() { this.view = { x: 0, y: 0, scale: Math.min(this.canvas.clientWidth / 9, this.canvas.clientHeight / 8) }; }
  show(points, margin = 1.8) {
    if (!points.length) return this.home();
    const [xs, ys] = [points.map((p) => p[0]), points.map((p) => p[1])];
    const [x0, x1, y0, y1] = [Math.min(...xs) - margin, Math.max(...xs) + margin, Math.min(...ys) - margin, Math.max(...ys) + margin];
    const scale = Math.min(this.canvas.clientWidth / (x1 - x0), this.canvas.clientHeight / (y1 - y0), 70);
    this.view = { x: (x0 + x1) / 2, y: (y0 + y1) / 2, scale };
  }

  // --- what is touched ---
  corner(point, kind) {
    const points = this.drawing ? this.drawing.points : [], reach = (REACH_PX[kind] || 12) / this.view.scale;
    let best = -1, least = reach;
    points.forEach(([x, y], i) => { const d = Math.hypot(x - point[0], y - point[1]); if (d <= least) [best, least] = [i, d]; });
    return best;
  }
  leg(point) {
    const d = this.drawing;
    if (!d) return -1;
    return d.widths.findIndex((width, i) => {
      const [[ax, ay], [bx, by]] = [d.points[i], d.points[i + 1]];
      const part = ((point[0] - ax) * (bx - ax) + (point[1] - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2);
      const t = Math.max(0, Math.min(1, part));
      return Math.hypot(ax + t * (bx - ax) - point[0], ay + t * (by - ay) - point[1]) < width / 2;
    });
  }
  snapped([x, y]) {
    const to = this.snap ? GRID_M : 0.01;
    return [Number((Math.round(x / to) * to).toFixed(3)), Number((Math.round(y / to) * to).toFixed(3))];
  }

  // --- pointers ---
  down(event) {
    if (event.button > 0) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.pointers.size === 2) { this.stroke = this.moving = this.held = null; return; }  // two fingers move the view
    if (this.pointers.size > 2 || !this.may()) return;
    const point = this.at(event), corner = this.corner(point, event.pointerType);
    this.begun = [event.clientX, event.clientY];
    this.dragged = false;
    const extends_ = this.tool === "free" && this.drawing && corner === this.drawing.points.length - 1;
    this.held = corner >= 0 && !extends_ ? corner : null;
    this.extends = extends_;
    this.touched = corner;
    this.stroke = this.held === null ? [point] : null;
  }
  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    if (this.pointers.size === 2) {
      const [, other] = [...this.pointers].find(([id]) => id !== event.pointerId);
      const factor = Math.hypot(now[0] - other[0], now[1] - other[1]) / Math.max(1, Math.hypot(before[0] - other[0], before[1] - other[1]));
      this.view.x -= (now[0] - before[0]) / 2 / this.view.scale;
      this.view.y += (now[1] - before[1]) / 2 / this.view.scale;
      this.zoom(factor);
    }
    this.pointers.set(event.pointerId, now);
    if (this.pointers.size !== 1 || !this.begun) return;
    this.dragged ||= Math.hypot(now[0] - this.begun[0], now[1] - this.begun[1]) > TAP_PX;
    if (this.held !== null && this.held !== undefined && this.dragged) {
      this.moving = structuredClone(this.drawing);
      this.moving.points[this.held] = this.snapped(this.at(event));
    } else if (this.stroke) {
      // Fast strokes: every place that the browser has seen.
      const seen = event.getCoalescedEvents ? event.getCoalescedEvents() : [];
      for (const each of seen.length ? seen : [event]) this.stroke.push(this.at(each));
    }
  }
  async up(event) {
    if (!this.pointers.delete(event.pointerId) || !this.begun) return;
    const [point, stroke, moving] = [this.at(event), this.stroke, this.moving];
    this.begun = null;
    this.moving = null;
    if (moving) { this.stroke = null; this.commit(moving); return; }
    if (!this.dragged) { this.stroke = null; this.tap(point, event.pointerType); return; }
    if (stroke && this.tool === "free") await this.drawn(stroke);
    this.stroke = null;
  }
  forget(event) {
    this.pointers.delete(event.pointerId);
    this.stroke = this.moving = this.begun = null;
  }

  async drawn(stroke) {
    const extended = this.extends ? this.drawing : null;
    const fitted = await this.fit(stroke);
    if (!fitted) return;
    if (this.snap) snapAll(fitted, (point) => this.snapped(point));
    if (fitted.points.length < 2) return;
    if (!extended) { this.commit(fitted, true); return; }
    this.commit({
      points: [...extended.points, ...fitted.points.slice(1)],
      widths: [...extended.widths, ...fitted.widths],
      radii: [...extended.radii, this.radius, ...fitted.radii],
    });
  }
  tap(point, kind) {
    const corner = this.corner(point, kind), leg = this.leg(point);
    if (corner >= 0) return this.select({ corner });
    if (leg >= 0) return this.select({ leg });
    if (this.tool !== "corner") return this.select(null);
    const placed = this.snapped(point);
    if (this.drawing) {
      const { points, widths, radii } = this.drawing;
      this.commit({ points: [...points, placed], widths: [...widths, this.width], radii: [...radii, this.radius] });
    } else if (this.pending) {
      const first = this.pending;
      this.pending = null;
      this.commit({ points: [first, placed], widths: [this.width], radii: [] });
    } else {
      this.pending = placed;
      this.selected();
    }
  }
  select(selection) {
    this.selection = selection;
    this.selected();
  }

  // --- changes, and back ---
  commit(drawing, afresh = false) {
    this.past.push(JSON.stringify(this.drawing));
    if (this.past.length > 200) this.past.shift();
    this.put(drawing);
    if (afresh) this.selection = null;
    this.changed(this.drawing);
  }
  put(drawing) {
    this.drawing = drawing;
    this.pending = null;
    // The next stroke is as wide as what is there, if that is as wide everywhere.
    if (drawing && drawing.widths.every((width) => width === drawing.widths[0])) this.width = drawing.widths[0];
    if (this.selection && (!drawing || (this.selection.corner ?? this.selection.leg) >= drawing.points.length - ("leg" in this.selection))) this.selection = null;
    this.selected();
  }
  undo() {
    if (this.pending) { this.pending = null; return; }
    if (!this.past.length) return;
    this.put(JSON.parse(this.past.pop()));
    this.changed(this.drawing);
  }
  remove() {
    const i = this.selection?.corner, d = this.drawing;
    if (i === undefined || !d) return;
    if (d.points.length <= 2) { this.commit(null); return; }
    const without = (list, k) => list.filter((_, j) => j !== k);
    this.commit({
      points: without(d.points, i),
      widths: without(d.widths, Math.min(i, d.widths.length - 1)),
      radii: without(d.radii, Math.max(0, Math.min(i - 1, d.radii.length - 1))),
    });
    this.select(null);
  }
  // The width of the selected leg, or of all; how round the selected corner is, or all are.
  set(field, value) {
    const { leg, corner } = this.selection ?? {};
    if (field === "widths" && leg === undefined) this.width = value;
    if (field === "radii" && corner === undefined) this.radius = value;
    if (!this.drawing) return;
    const changed = structuredClone(this.drawing);
    if (field === "widths") changed.widths = changed.widths.map((w, i) => (leg === undefined || leg === i ? value : w));
    else changed.radii = changed.radii.map((r, i) => (corner === undefined || corner === i + 1 ? value : r));
    this.commit(changed);
  }
}

// Corners on the grid; those that fall on each other are one.
function snapAll(drawing, snapped) {
  const points = drawing.points.map(snapped);
  const keep = points.map((p, i) => i === 0 || p[0] !== points[i - 1][0] || p[1] !== points[i - 1][1]);
  drawing.radii = drawing.radii.filter((_, i) => keep[i + 1] && i + 2 < points.length);
  drawing.points = points.filter((_, i) => keep[i]);
  drawing.widths = drawing.widths.slice(0, drawing.points.length - 1);
  drawing.radii = drawing.radii.slice(0, Math.max(0, drawing.points.length - 2));
}

// --- the drawing in an address: "x,y,x,y,...|width,...|radius,..." ---
function toHash({ points, widths, radii }) {
  const line = (list) => list.flat().map((value) => String(Number(value.toFixed(3)))).join(",");
  return `#track=${line(points)}|${line(widths)}|${line(radii)}`;
}
function fromHash(hash) {
  if (!hash.startsWith("#track=")) return null;
  const [flat, widths, radii] = decodeURIComponent(hash.slice(7)).split("|").map((part) => (part ? part.split(",").map(Number) : []));
  const points = flat.filter((_, i) => i % 2 === 0).map((x, i) => [x, flat[2 * i + 1]]);
  return { points, widths: widths ?? [], radii: radii ?? [] };
}
