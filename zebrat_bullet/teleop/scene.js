"use strict";
// Walls, cars and scans from above, drawn with a pen whose unit is the metre; `pixel` is the size of one in metres.

function trace(pen, points, close) {
  points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  if (close) pen.closePath();
}

function toFrame(pen, [x, y, yaw]) { pen.translate(x, y); pen.rotate(yaw); }

// The pose between two views, `part` of the way.
function smoothed(last, now, part) {
  const [a, b, p] = [last.pose, now.pose, Math.min(1, part)];
  const turn = Math.atan2(Math.sin(b[2] - a[2]), Math.cos(b[2] - a[2]));
  return [a[0] + p * (b[0] - a[0]), a[1] + p * (b[1] - a[1]), a[2] + p * turn];
}

function drawWalls(pen, walls, colour = "#596273") {
  pen.fillStyle = colour;
  pen.beginPath();
  for (const rings of walls) for (const ring of rings) trace(pen, ring, true);
  pen.fill("evenodd");
}

function bearing(i, n) { return -Math.PI + (2 * Math.PI * i) / n; }

// In the frame of the pose it was taken at.
function drawScan(pen, car, view, pixel) {
  pen.save();
  toFrame(pen, view.pose);
  pen.translate(...car.lidar);
  const n = view.scan_mm.length;
  car.indices.forEach((k, i) => {
    const [c, s, range] = [Math.cos(bearing(k, n)), Math.sin(bearing(k, n)), view.scan_mm[k] / 1000];
    const gap = range - car.range_m[i];
    pen.strokeStyle = gap < 0.1 ? "#ff7b72" : gap < 0.3 ? "#e3b341" : "#2f6f5e";
    pen.lineWidth = 1.5 * pixel;
    pen.beginPath();
    trace(pen, [[c * car.range_m[i], s * car.range_m[i]], [c * range, s * range]]);
    pen.stroke();
  });
  pen.fillStyle = "#7cc4ff";
  view.scan_mm.forEach((mm, i) => {
    if (mm >= 1000 * car.range_max_m) return;
    const [x, y] = [(mm / 1000) * Math.cos(bearing(i, n)), (mm / 1000) * Math.sin(bearing(i, n))];
    pen.fillRect(x - 1.5 * pixel, y - 1.5 * pixel, 3 * pixel, 3 * pixel);
  });
  pen.restore();
}

function drawCar(pen, car, pose, steering, pixel, colour = "#e8eaed") {
  pen.save();
  toFrame(pen, pose);
  pen.fillStyle = colour;
  pen.beginPath();
  trace(pen, car.footprint, true);
  pen.fill();
  const front = car.rear_axle_x_m + car.wheelbase_m, half = car.track_m / 2, r = car.wheel_radius_m;
  for (const wheel of [
    [car.rear_axle_x_m, half, 0], [car.rear_axle_x_m, -half, 0], [front, half, steering], [front, -half, steering],
  ]) {
    pen.save();
    toFrame(pen, wheel);
    pen.fillStyle = "#14171c";
    pen.fillRect(-r, -0.05, 2 * r, 0.1);
    pen.restore();
  }
  pen.fillStyle = "#3d7eff";
  pen.beginPath();
  pen.arc(...car.lidar, 0.06, 0, 2 * Math.PI);
  pen.fill();
  // The safety region: the outline that the 32 bearings watch.
  pen.strokeStyle = "#6fd08c";
  pen.lineWidth = 2 * pixel;
  pen.beginPath();
  trace(pen, regionOf(car), true);
  pen.stroke();
  pen.restore();
}

function regionOf(car) {
  const n = car.n_bearings;
  return car.indices.map((k, i) => [
    car.lidar[0] + car.range_m[i] * Math.cos(bearing(k, n)), car.lidar[1] + car.range_m[i] * Math.sin(bearing(k, n)),
  ]);
}
