'use strict';
// Reads the recording: a gzip file in base64 that holds a header (JSON) and arrays of numbers.

async function unpack(text) {
  const raw = atob(text.trim());
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'));
  const content = await new Response(stream).arrayBuffer();
  const length = new DataView(content).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(content, 4, length)));
  const types = {
    float64: Float64Array, float32: Float32Array, int32: Int32Array, uint32: Uint32Array,
    int16: Int16Array, uint16: Uint16Array, uint8: Uint8Array, int64: BigInt64Array,
  };
  const arrays = {};
  for (const [name, told] of Object.entries(header.arrays)) {
    const Type = types[told.type];
    arrays[name] = new Type(content, 4 + length + told.at, told.bytes / Type.BYTES_PER_ELEMENT);
  }
  return new Recording(header.meta, arrays);
}

const CORRECTIONS = new Set(['new', 'again']);
const DECISIONS = new Set(['new', 'again', 'waits']);

class Recording {
  constructor(meta, arrays) {
    const {level, ...others} = arrays;
    Object.assign(this, others);
    this.levels = level;
    this.meta = meta;
    this.frames = arrays.time.length;
    this.robots = meta.robots;
    const start = arrays.time[0];
    this.seconds = Float64Array.from(arrays.time, (time) => time - start);
    this.events = meta.events.map((event, index) => ({...event, t: event.t - start, index}));
    this.events.sort((a, b) => a.t - b.t || a.index - b.index);
    this.events.forEach((event, index) => { event.index = index; });
    this.hasTruth = 'true' in arrays;
    this.duration = this.seconds[this.frames - 1];
    this.gridState = null;
  }

  frameAt(seconds) { return Math.max(firstAfter(this.seconds, seconds + 1e-6) - 1, 0); }

  // Number of events up to the moment of a frame.
  eventsUntil(frame) {
    let low = 0, high = this.events.length;
    const limit = this.seconds[frame] + 1e-6;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.events[middle].t <= limit) low = middle + 1; else high = middle;
    }
    return low;
  }

  latest(frame, accepts) {
    for (let i = this.eventsUntil(frame) - 1; i >= 0; i--) if (accepts(this.events[i])) return this.events[i];
    return null;
  }

  poseOf(kind, frame, robot) {
    const at = 3 * (frame * this.robots + robot), array = this[kind];
    return [array[at], array[at + 1], array[at + 2]];
  }

  covariance(frame, robot) { return this.cov.subarray(6 * (frame * this.robots + robot), 6 * (frame * this.robots + robot) + 6); }

  // Errors of position (m) and heading (rad), and the standard deviations that the filter states.
  errors(frame, robot) {
    const cov = this.covariance(frame, robot);
    const std = {position: Math.sqrt(Math.max(cov[0] + cov[3], 0)), heading: Math.sqrt(Math.max(cov[5], 0))};
    if (!this.hasTruth) return {...std, position_error: NaN, heading_error: NaN};
    const believed = this.poseOf('pose', frame, robot), truly = this.poseOf('true', frame, robot);
    return {
      ...std,
      position_error: Math.hypot(believed[0] - truly[0], believed[1] - truly[1]),
      heading_error: wrapped(believed[2] - truly[2]),
    };
  }

  level(frame) {
    let worst = 0;
    for (let robot = 0; robot < this.robots; robot++) worst = Math.max(worst, this.level_of(frame, robot));
    return worst;
  }

  level_of(frame, robot) { return this.levels[frame * this.robots + robot]; }

  reasonWords(frame) {
    const names = ['ok', 'unsure', 'lost'];
    for (let robot = 0; robot < this.robots; robot++) {
      if (this.level_of(frame, robot) !== this.level(frame)) continue;
      const reason = this.meta.reasons[this.reason[frame * this.robots + robot]];
      const who = this.robots > 1 && reason ? `robot ${robot + 1}: ` : '';
      return reason ? `${names[this.level(frame)]}: ${who}${reason}` : names[this.level(frame)];
    }
    return names[0];
  }

  // The buffers of a frame: robot, side, number of points, new points and size, and where their points begin.
  buffersOf(frame) {
    const sides = ['left', 'right', 'ahead'], found = [];
    let from = this.pending_starts[frame];
    for (let place = 0; place < 3 * this.robots; place++) {
      const at = 3 * (3 * this.robots * frame + place);
      const [count, fresh, size] = [this.buffers[at], this.buffers[at + 1], this.buffers[at + 2]];
      found.push({robot: Math.floor(place / 3), side: sides[place % 3], count, fresh, size, from});
      from += count;
    }
    return found;
  }

  lengths(array, from, to) {
    const out = new Float32Array(to - from);
    for (let i = from; i < to; i++) out[i - from] = array[i] * this.meta.quantum;
    return out;
  }

  // Walls of the map (x1, y1, x2, y2, number of the landmark).
  wallsOf(frame) {
    const state = this.map_index[frame], found = [];
    for (let row = this.wall_starts[state]; row < this.wall_starts[state + 1]; row++) {
      const [a, b, c, d] = this.lengths(this.walls, 5 * row, 5 * row + 4);
      found.push({ends: [a, b, c, d], wall: this.walls[5 * row + 4]});
    }
    return found;
  }

  // Landmarks: number, (r, theta) with covariance, number of observations, ends.
  marksOf(frame) {
    const state = this.map_index[frame], found = [];
    for (let row = this.mark_starts[state]; row < this.mark_starts[state + 1]; row++) {
      const [wall, r, theta, rr, rt, tt, count] = this.marks.subarray(7 * row, 7 * row + 7);
      found.push({wall, r, theta, rr, rt, tt, count, ends: this.lengths(this.mark_ends, 4 * row, 4 * row + 4)});
    }
    return found;
  }

  planOf(frame, robot) {
    const state = this.plan_index[frame] * this.robots + robot;
    return this.lengths(this.plans, 2 * this.plan_starts[state], 2 * this.plan_starts[state + 1]);
  }

  goalOf(frame, robot) {
    const at = 2 * (frame * this.robots + robot);
    return Number.isNaN(this.goal[at]) ? null : [this.goal[at], this.goal[at + 1]];
  }

  frontiersOf(frame) {
    const state = this.frontier_index[frame];
    if (state < 0) return [];
    return this.meta.frontiers[state].map(({cells, costs}) => {
      const points = this.lengths(this.frontier_cells, 2 * this.frontier_starts[cells], 2 * this.frontier_starts[cells + 1]);
      let x = 0, y = 0;
      for (let i = 0; i < points.length; i += 2) { x += points[i]; y += points[i + 1]; }
      return {points, costs, x: (2 * x) / points.length, y: (2 * y) / points.length};
    });
  }

  // The kinds of all cells at a frame, by rows and columns from the origin of the map.
  gridOf(frame) {
    if (!this.gridState || this.gridState.frame > frame) this.gridState = this.emptyGrid();
    const state = this.gridState;
    for (let run = this.grid_starts[state.frame + 1]; run < this.grid_starts[frame + 1]; run++) {
      const row = this.grid[4 * run] - state.row, column = this.grid[4 * run + 1] - state.column;
      const begin = row * state.columns + column;
      state.kinds.fill(this.grid[4 * run + 3], begin, begin + this.grid[4 * run + 2]);
    }
    state.frame = frame;
    return state;
  }

  emptyGrid() {
    let row = Infinity, column = Infinity, top = -Infinity, right = -Infinity;
    for (let at = 0; at < this.grid.length; at += 4) {
      row = Math.min(row, this.grid[at]);
      top = Math.max(top, this.grid[at] + 1);
      column = Math.min(column, this.grid[at + 1]);
      right = Math.max(right, this.grid[at + 1] + this.grid[at + 2]);
    }
    if (!this.grid.length) row = column = top = right = 0;
    const rows = top - row, columns = right - column;
    return {row, column, rows, columns, kinds: new Uint8Array(rows * columns), frame: -1};
  }

  // The wall that is meant by a number at a moment: a wall that was merged goes on as the older one.
  nowCalled(wall, frame) {
    if (!this.meta.merges) return wall;
    const until = this.eventsUntil(frame);
    for (let i = 0; i < until; i++) {
      const event = this.events[i];
      if (event.kind === 'loop' && event.wall === wall) wall = event.other;
    }
    return wall;
  }
}

function firstAfter(sorted, value) {
  let low = 0, high = sorted.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (sorted[middle] <= value) low = middle + 1; else high = middle;
  }
  return low;
}

function wrapped(angle) { return angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI)); }
