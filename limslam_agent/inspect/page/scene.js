
// Draws the two pictures: the truth, and the belief. Both show the same part of the plane.

const LAYERS = {
  grid: ['Grid', true], beams: ['Beams', true], points: ['Buffers', true], bands: ['2\u03c3 bands', true],
  numbers: ['Numbers', true], frontiers: ['Frontiers', true], plan: ['Plan', true], path: ['Paths', true],
  odometry: ['Odometry', false], over: ['True walls', false], smoothed: ['Smoothed', false],
};
const CHI = Math.sqrt(5.991);  // 95 % of two dimensions
const ROBOT_NAMES = ['robot1', 'robot2', 'robot3', 'robot4', 'robot5', 'robot6'];

class Scene {
  constructor(recording, canvases, colours) {
    this.recording = recording;
    this.canvases = canvases;
    this.colours = colours;
    this.on = Object.fromEntries(Object.entries(LAYERS).map(([name, [, shown]]) => [name, shown]));
    this.bounds = boundsOf(recording);
    this.follows = false;
    this.gridImage = document.createElement('canvas');
    this.sizes = new Map();
    this.measure();
    this.fit();
  }

  // The sizes of the pictures are asked for only when they may have changed: asking makes the browser lay the page out.
  measure() {
    for (const canvas of Object.values(this.canvases)) this.sizes.set(canvas, [canvas.clientWidth, canvas.clientHeight]);
  }

  fit() {
    const [x0, y0, x1, y1] = this.bounds;
    this.centre = [(x0 + x1) / 2, (y0 + y1) / 2];
    this.zoom = 1;
  }

  zoomBy(factor, about) {
    const zoom = Math.min(Math.max(this.zoom * factor, 0.5), 40);
    if (about) for (const i of [0, 1]) this.centre[i] = about[i] + (this.centre[i] - about[i]) * (this.zoom / zoom);
    this.zoom = zoom;
  }

  scaleOf(canvas) {
    const [x0, y0, x1, y1] = this.bounds;
    const [width, height] = this.sizes.get(canvas);
    const fitting = Math.min(width / (x1 - x0), height / (y1 - y0));
    return fitting * this.zoom;
  }

  // From pixels of a canvas to the plane, m.
  toWorld(canvas, x, y) {
    const scale = this.scaleOf(canvas), [width, height] = this.sizes.get(canvas);
    return [this.centre[0] + (x - width / 2) / scale, this.centre[1] - (y - height / 2) / scale];
  }

  draw(frame) {
    if (this.follows) this.centre = this.recording.poseOf('pose', frame, 0).slice(0, 2);
    this.event = this.recording.latest(frame, (event) => DECISIONS.has(event.kind) || event.kind === 'loop');
    const isShown = (canvas) => this.sizes.get(canvas)[0] > 0;
    if (isShown(this.canvases.truth)) this.drawTruth(this.begin(this.canvases.truth), frame);
    if (isShown(this.canvases.belief)) this.drawBelief(this.begin(this.canvases.belief), frame);
  }

  begin(canvas) {
    const ratio = window.devicePixelRatio || 1, [width, height] = this.sizes.get(canvas);
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext('2d'), scale = this.scaleOf(canvas);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = this.colours.unknown;
    pen.fillRect(0, 0, width, height);
    // From here on in metres, y upwards. A pixel is 1 / scale.
    pen.setTransform(ratio * scale, 0, 0, -ratio * scale, ratio * (width / 2 - this.centre[0] * scale), ratio * (height / 2 + this.centre[1] * scale));
    pen.lineJoin = pen.lineCap = 'round';
    this.pixel = 1 / scale;
    return pen;
  }

  drawTruth(pen, frame) {
    const {recording, colours} = this;
    this.paper(pen, colours.paper);
    if (recording.edges) this.segments(pen, recording.edges, 4, colours.ink, 2.5);
    if (!recording.hasTruth) return;
    for (let robot = 0; robot < recording.robots; robot++) {
      if (this.on.path) this.path(pen, 'true', robot, frame, this.robotColour(robot), 1.2);
      const pose = recording.poseOf('true', frame, robot);
      if (this.on.beams) this.beams(pen, pose, frame, robot, false);
      this.body(pen, pose, this.robotColour(robot));
    }
  }

  drawBelief(pen, frame) {
    const {recording, colours} = this;
    this.paper(pen, this.on.grid ? colours.unknown : colours.paper);
    if (this.on.grid) this.grid(pen, frame);
    if (this.on.over && recording.edges) this.segments(pen, recording.edges, 4, colours.ghost, 1.5);
    if (this.on.frontiers) this.frontierCells(pen, frame);
    if (this.on.smoothed && recording.final_walls) this.segments(pen, recording.final_walls, 4, colours.smoothed, 1.5);
    const marks = recording.marksOf(frame), walls = recording.wallsOf(frame);
    if (this.on.bands) this.bands(pen, marks);
    const shown = new Set(walls.map(({wall}) => wall));
    for (const mark of marks) if (!shown.has(mark.wall)) this.line(pen, mark.ends, colours.wall, 1, [3, 3]);
    const touched = this.touchedWalls(frame);
    for (const {ends, wall} of walls) {
      if (touched.has(wall)) this.line(pen, ends, `${colours.glow}aa`, 8);
      this.line(pen, ends, colours.wall, 2.6);
    }
    for (let robot = 0; robot < recording.robots; robot++) {
      const colour = this.robotColour(robot);
      if (this.on.odometry) this.path(pen, 'odometry', robot, frame, colours.faint, 1.2, [4, 3]);
      if (this.on.smoothed && recording.smoothed) this.path(pen, 'smoothed', robot, recording.frames - 1, colours.smoothed, 1.2);
      if (this.on.path) this.path(pen, 'pose', robot, frame, colour, 1.2);
      if (this.on.plan) this.plan(pen, frame, robot);
      const pose = recording.poseOf('pose', frame, robot);
      if (this.on.beams) this.beams(pen, pose, frame, robot, true);
    }
    if (this.on.smoothed) { this.graph(pen, frame); this.pathLoops(pen, frame); }
    if (this.on.points) this.buffers(pen, frame);
    this.observed(pen, frame);
    for (let robot = 0; robot < recording.robots; robot++) {
      const pose = recording.poseOf('pose', frame, robot);
      this.uncertainty(pen, pose, recording.covariance(frame, robot), this.robotColour(robot));
      this.body(pen, pose, this.robotColour(robot));
    }
    if (this.on.numbers) this.numbers(pen, marks, touched);
    if (this.on.frontiers) this.costs(pen, frame);
  }

  paper(pen, colour) {
    const [x0, y0, x1, y1] = this.bounds;
    pen.fillStyle = colour;
    pen.fillRect(x0, y0, x1 - x0, y1 - y0);
  }

  robotColour(robot) { return this.colours[ROBOT_NAMES[robot % ROBOT_NAMES.length]]; }

  line(pen, [x0, y0, x1, y1], colour, width, dashes = []) {
    pen.strokeStyle = colour;
    pen.lineWidth = width * this.pixel;
    pen.setLineDash(dashes.map((length) => length * this.pixel));
    pen.beginPath();
    pen.moveTo(x0, y0);
    pen.lineTo(x1, y1);
    pen.stroke();
    pen.setLineDash([]);
  }

  segments(pen, array, width, colour, thickness) {
    pen.strokeStyle = colour;
    pen.lineWidth = thickness * this.pixel;
    pen.beginPath();
    for (let at = 0; at < array.length; at += width) {
      pen.moveTo(array[at], array[at + 1]);
      pen.lineTo(array[at + 2], array[at + 3]);
    }
    pen.stroke();
  }

  path(pen, kind, robot, until, colour, width, dashes = []) {
    const {robots} = this.recording, array = this.recording[kind];
    pen.strokeStyle = colour;
    pen.lineWidth = width * this.pixel;
    pen.globalAlpha = 0.75;
    pen.setLineDash(dashes.map((length) => length * this.pixel));
    pen.beginPath();
    for (let frame = 0; frame <= until; frame++) {
      const at = 3 * (frame * robots + robot);
      if (frame && Math.hypot(array[at] - array[at - 3 * robots], array[at + 1] - array[at + 1 - 3 * robots]) > 1) {
        pen.moveTo(array[at], array[at + 1]);  // carried away, or another frame
      } else pen.lineTo(array[at], array[at + 1]);
    }
    pen.stroke();
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  }

  body(pen, [x, y, heading], colour) {
    const radius = Math.max(this.recording.meta.radius, 5 * this.pixel);
    pen.fillStyle = colour;
    pen.strokeStyle = this.colours.paper;
    pen.lineWidth = 1.5 * this.pixel;
    pen.beginPath();
    pen.arc(x, y, radius, 0, 2 * Math.PI);
    pen.fill();
    pen.stroke();
    this.line(pen, [x, y, x + radius * Math.cos(heading), y + radius * Math.sin(heading)], this.colours.paper, 2);
  }

  // The ellipse holds the position, and the sector the heading, with 95 %.
  uncertainty(pen, [x, y, heading], cov, colour) {
    const [xx, xy, , yy, , tt] = cov;
    const half = (xx + yy) / 2, root = Math.hypot((xx - yy) / 2, xy);
    const angle = 0.5 * Math.atan2(2 * xy, xx - yy);
    const width = Math.min(2 * Math.sqrt(Math.max(tt, 0)), Math.PI), reach = this.recording.meta.radius + 28 * this.pixel;
    pen.fillStyle = colour;
    pen.globalAlpha = 0.22;
    pen.beginPath();
    pen.moveTo(x, y);
    pen.arc(x, y, reach, heading - width, heading + width);
    pen.fill();
    pen.globalAlpha = 1;
    const longest = CHI * Math.sqrt(half + root), extent = this.bounds[2] - this.bounds[0];
    if (longest > 2 * extent) return;  // the place is not known at all
    pen.globalAlpha = longest > 0.3 * extent ? 0.04 : 0.22;
    pen.beginPath();
    pen.ellipse(x, y, CHI * Math.sqrt(Math.max(half + root, 0)), CHI * Math.sqrt(Math.max(half - root, 0)), angle, 0, 2 * Math.PI);
    pen.fill();
    pen.globalAlpha = 1;
    pen.strokeStyle = colour;
    pen.lineWidth = 1.2 * this.pixel;
    pen.stroke();
  }

  beams(pen, [x, y, heading], frame, robot, areBelieved) {
    const {recording, colours} = this, count = recording.meta.beams.length;
    const cos = Math.cos(heading), sin = Math.sin(heading);
    recording.meta.beams.forEach((beam, number) => {
      const at = (frame * recording.robots + robot) * count + number, range = recording.ranges[at];
      if (!range) return;
      const length = range === 65535 ? beam.max : range / 1000;
      const from = [x + cos * beam.x - sin * beam.y, y + sin * beam.x + cos * beam.y];
      const to = [from[0] + length * Math.cos(heading + beam.angle), from[1] + length * Math.sin(heading + beam.angle)];
      pen.globalAlpha = range === 65535 ? 0.3 : 0.75;
      this.line(pen, [...from, ...to], colours.beam, 1);
      pen.globalAlpha = 1;
      if (range !== 65535) this.dot(pen, to, areBelieved && recording.owner[at] ? colours.wall : colours.beam, 3);
    });
  }

  dot(pen, [x, y], colour, size) {
    pen.fillStyle = colour;
    pen.beginPath();
    pen.arc(x, y, size * this.pixel, 0, 2 * Math.PI);
    pen.fill();
  }

  buffers(pen, frame) {
    const {recording, colours} = this;
    for (const {side, count, from} of recording.buffersOf(frame)) {
      const points = recording.lengths(recording.pending, 2 * from, 2 * (from + count));
      for (let i = 0; i < points.length; i += 2) this.dot(pen, [points[i], points[i + 1]], colours[side], 2.6);
    }
  }

  grid(pen, frame) {
    const {kinds, rows, columns, row, column} = this.recording.gridOf(frame);
    if (!rows || !columns) return;
    const image = this.gridImage, cell = this.recording.meta.cell;
    if (image.width !== columns || image.height !== rows) [image.width, image.height] = [columns, rows];
    const small = image.getContext('2d'), pixels = small.createImageData(columns, rows);
    const palette = ['unknown', 'free', 'occupied'].map((name) => channels(this.colours[name]));
    const words = new Uint32Array(pixels.data.buffer);
    for (let r = 0; r < rows; r++) {
      for (let c = 0; c < columns; c++) words[(rows - 1 - r) * columns + c] = palette[kinds[r * columns + c]];
    }
    small.putImageData(pixels, 0, 0);
    pen.save();
    pen.imageSmoothingEnabled = false;
    pen.translate(column * cell, (row + rows) * cell);
    pen.scale(1, -1);
    pen.drawImage(image, 0, 0, columns * cell, rows * cell);
    pen.restore();
  }

  // The regions that hold the walls with 2 sigma: wider where a wall was not seen. One fill for all of them is faster.
  bands(pen, marks) {
    pen.fillStyle = this.colours.wall;
    pen.globalAlpha = 0.18;
    pen.beginPath();
    for (const mark of marks) this.band(pen, mark);
    pen.fill();
    pen.globalAlpha = 1;
  }

  band(pen, {theta, rr, rt, tt, ends: [x0, y0, x1, y1]}) {
    const cos = Math.cos(theta), sin = Math.sin(theta), left = [], right = [];
    for (let i = 0; i <= 8; i++) {
      const x = x0 + (i / 8) * (x1 - x0), y = y0 + (i / 8) * (y1 - y0), s = y * cos - x * sin;
      const half = 2 * Math.sqrt(Math.max(rr - 2 * s * rt + s * s * tt, 0));
      left.push([x + half * cos, y + half * sin]);
      right.unshift([x - half * cos, y - half * sin]);
    }
    // All in one direction of turning, so that regions that overlap do not cancel.
    const outline = left.concat(right), isTurned = (x1 - x0) * sin - (y1 - y0) * cos > 0;
    if (isTurned) outline.reverse();
    outline.forEach(([x, y], place) => { if (place) pen.lineTo(x, y); else pen.moveTo(x, y); });
    pen.closePath();
  }

  frontierCells(pen, frame) {
    const cell = this.recording.meta.cell, side = 0.8 * cell;
    pen.fillStyle = this.colours.frontier;
    for (const {points} of this.recording.frontiersOf(frame)) {
      for (let i = 0; i < points.length; i += 2) pen.fillRect(points[i] - side / 2, points[i + 1] - side / 2, side, side);
    }
  }

  costs(pen, frame) {
    for (const {x, y, costs} of this.recording.frontiersOf(frame)) {
      const known = costs.filter((cost) => cost !== null);
      if (known.length) this.words(pen, Math.min(...known).toFixed(1), [x, y], this.colours.frontierInk);
    }
  }

  plan(pen, frame, robot) {
    const points = this.recording.planOf(frame, robot), goal = this.recording.goalOf(frame, robot);
    pen.strokeStyle = this.colours.plan;
    pen.lineWidth = 2 * this.pixel;
    pen.setLineDash([5 * this.pixel, 4 * this.pixel]);
    pen.beginPath();
    for (let i = 0; i < points.length; i += 2) pen.lineTo(points[i], points[i + 1]);
    pen.stroke();
    pen.setLineDash([]);
    if (!goal) return;
    pen.beginPath();
    pen.arc(goal[0], goal[1], 6 * this.pixel, 0, 2 * Math.PI);
    pen.stroke();
  }

  // The line of the latest decision, for a moment.
  observed(pen, frame) {
    const {event, recording} = this;
    if (!event || !event.ends || recording.seconds[frame] - event.t > 1.0) return;
    this.line(pen, event.ends, CORRECTIONS.has(event.kind) ? this.colours.good : this.colours.glow, 4);
  }

  touchedWalls(frame) {
    const {event, recording} = this;
    if (!event || recording.seconds[frame] - event.t > 1.0) return new Set();
    return new Set([event.wall, event.other].filter(Boolean).map((wall) => recording.nowCalled(wall, frame)));
  }

  numbers(pen, marks, touched) {
    for (const {wall, ends, theta} of marks) {
      const middle = [(ends[0] + ends[2]) / 2, (ends[1] + ends[3]) / 2], off = 10 * this.pixel;
      this.words(pen, String(wall), [middle[0] + off * Math.cos(theta), middle[1] + off * Math.sin(theta)], this.colours.wallInk, touched.has(wall));
    }
  }

  words(pen, text, [x, y], colour, isBold = false) {
    pen.save();
    pen.translate(x, y);
    pen.scale(this.pixel, -this.pixel);
    pen.font = `${isBold ? 'bold 13px' : '11px'} system-ui, sans-serif`;
    pen.textAlign = 'center';
    pen.textBaseline = 'middle';
    pen.lineWidth = 3;
    pen.strokeStyle = this.colours.paper;
    pen.strokeText(text, 0, 0);
    pen.fillStyle = colour;
    pen.fillText(text, 0, 0);
    pen.restore();
  }

  // Key poses as dots, and local maps as diamonds; the local map of the moment is the thick part of the path.
  graph(pen, frame) {
    const {recording, colours} = this, poses = recording.smoothed, {key_poses: keys, local_maps: maps} = recording.meta.graph || {};
    if (!poses || !maps || !maps.length) return;
    const place = (seconds) => { const at = 3 * recording.robots * recording.frameAt(seconds); return [poses[at], poses[at + 1]]; };
    for (const seconds of keys) this.dot(pen, place(seconds), colours.smoothed, 1.6);
    const now = recording.seconds[frame], current = nearest(maps, now);
    const borders = [-1, 1].map((way) => (maps[current + way] === undefined ? maps[current] + way * 1e9 : (maps[current] + maps[current + way]) / 2));
    pen.strokeStyle = colours.smoothed;
    pen.lineWidth = 5 * this.pixel;
    pen.globalAlpha = 0.5;
    pen.beginPath();
    for (let at = recording.frameAt(borders[0]); at <= recording.frameAt(borders[1]); at++) pen.lineTo(poses[3 * recording.robots * at], poses[3 * recording.robots * at + 1]);
    pen.stroke();
    pen.globalAlpha = 1;
    for (const seconds of maps) {
      const [x, y] = place(seconds), half = 5 * this.pixel;
      pen.fillStyle = seconds <= now ? colours.smoothed : colours.paper;
      pen.strokeStyle = colours.smoothed;
      pen.lineWidth = 1.2 * this.pixel;
      pen.beginPath();
      for (const [dx, dy] of [[half, 0], [0, half], [-half, 0], [0, -half]]) pen.lineTo(x + dx, y + dy);
      pen.closePath();
      pen.fill();
      pen.stroke();
    }
  }

  // The loops of a log that was smoothed by its local maps: chords between two places of the path.
  pathLoops(pen, frame) {
    const {recording, colours} = this, poses = recording.smoothed;
    if (!poses) return;
    for (const loop of recording.meta.path_loops || []) {
      const [a, b] = [loop.first, loop.second].map((seconds) => 3 * recording.robots * recording.frameAt(seconds));
      const isPast = recording.seconds[frame] >= Math.max(loop.first, loop.second);
      pen.globalAlpha = isPast ? 0.9 : 0.25;
      this.line(pen, [poses[a], poses[a + 1], poses[b], poses[b + 1]], loop.reason === 'kept' ? colours.good : colours.bad, 1.5, loop.reason === 'kept' ? [] : [2, 3]);
      pen.globalAlpha = 1;
    }
  }
}

function boundsOf(recording) {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  const add = (x, y) => {
    box[0] = Math.min(box[0], x); box[1] = Math.min(box[1], y);
    box[2] = Math.max(box[2], x); box[3] = Math.max(box[3], y);
  };
  for (const name of ['true', 'pose']) {
    const poses = recording[name] || [];
    for (let at = 0; at < poses.length; at += 3) add(poses[at], poses[at + 1]);
  }
  const edges = recording.edges || recording.final_walls || [];
  for (let at = 0; at < edges.length; at += 2) add(edges[at], edges[at + 1]);
  const {row, column, rows, columns} = recording.emptyGrid(), {cell} = recording.meta;
  // Where the true walls are not known, all of the map is shown, and not the path alone.
  if (!recording.edges && rows) {
    add(column * cell, row * cell);
    add((column + columns) * cell, (row + rows) * cell);
  }
  const margin = 0.055 * Math.max(box[2] - box[0], box[3] - box[1], 1);
  return [box[0] - margin, box[1] - margin, box[2] + margin, box[3] + margin];
}

// The index of the number of a sorted list that is nearest to a value.
function nearest(sorted, value) {
  const after = Math.min(firstAfter(sorted, value), sorted.length - 1);
  return after > 0 && value - sorted[after - 1] < sorted[after] - value ? after - 1 : after;
}

// A colour as one number of four channels, as the pixels of an image hold it.
function channels(colour) {
  const value = Number.parseInt(colour.slice(1), 16);
  return (0xff000000 | ((value & 0xff) << 16) | (value & 0xff00) | (value >> 16)) >>> 0;
}
