// What `limslam worlds check` looks for, on the same grid (limslam_env/worlds/free_space.py and regions.py), and the
// text of a world's file. Lengths are in metres. Where an outline is open is said by the command alone.

const CELL = 0.025, MAX_CELLS = 4e6, COARSEST = 0.6, LARGEST = 500, SMALL_SHARE = 0.5, OPEN_SHARE = 0.25, SHORTEST = 1e-6;
const KEYS = {walls: 4, obstacles: 2, doors: 4, starts: 3, loop: 2};

const polygonEdges = (polygon) => polygon.map((corner, index) => [...corner, ...polygon[(index + 1) % polygon.length]]);
const edgesOf = (world) => [...world.walls, ...world.obstacles.flatMap(polygonEdges)];

function extentOf(edges) {
  const xs = edges.flatMap(([x1, , x2]) => [x1, x2]), ys = edges.flatMap(([, y1, , y2]) => [y1, y2]);
  const [left, right, bottom, top] = [xs, ys].flatMap((each) => [each.reduce((a, b) => Math.min(a, b), Infinity), each.reduce((a, b) => Math.max(a, b), -Infinity)]);
  return {left, right, bottom, top};
}

function shareAlong(x, y, [x1, y1, x2, y2]) {
  const ex = x2 - x1, ey = y2 - y1;
  return Math.min(Math.max(((x - x1) * ex + (y - y1) * ey) / Math.max(ex * ex + ey * ey, 1e-300), 0), 1);
}

function distanceTo(x, y, edge) {
  const share = shareAlong(x, y, edge), [x1, y1, x2, y2] = edge;
  return Math.hypot(x - x1 - share * (x2 - x1), y - y1 - share * (y2 - y1));
}

const isInside = (x, y, polygon) => polygonEdges(polygon).filter(([x1, y1, x2, y2]) => (y1 > y) !== (y2 > y) && x < ((x2 - x1) * (y - y1)) / (y2 - y1) + x1).length % 2 === 1;

// A grid around the walls, and the number of the region of each cell in which the middle of a robot fits; 0 where it does not.
function spaceOf(world, edges, around, radius, cell) {
  const margin = Math.max(2 * radius, 3 * cell), x = around.left - margin - 0.5 * cell, y = around.bottom - margin - 0.5 * cell;
  const columns = Math.ceil((around.right + margin - x) / cell) + 1, rows = Math.ceil((around.top + margin - y) / cell) + 1;
  const free = new Uint8Array(rows * columns).fill(1);
  const clipped = (low, high, origin, count) => [Math.min(Math.max(Math.floor((low - origin) / cell), 0), count), Math.min(Math.max(Math.ceil((high - origin) / cell), 0), count)];
  const reach = radius + cell, within = (value) => Math.min(Math.max(value, 0), 1);
  for (const edge of edges) {
    const [x1, y1, x2, y2] = edge, ex = x2 - x1, ey = y2 - y1;
    const [firstRow, endRow] = clipped(Math.min(y1, y2) - reach, Math.max(y1, y2) + reach, y, rows);
    for (let row = firstRow; row < endRow; row++) {
      const above = y + (row + 0.5) * cell - y1, isFlat = Math.abs(ey) < 1e-12;
      const from = x1 + (isFlat ? 0 : within((above - reach) / ey)) * ex, to = x1 + (isFlat ? 1 : within((above + reach) / ey)) * ex;
      const [first, last] = clipped(Math.min(from, to) - reach, Math.max(from, to) + reach, x, columns);
      for (let column = first; column < last; column++) {
        const at = row * columns + column;
        if (free[at] && distanceTo(x + (column + 0.5) * cell, y1 + above, edge) < radius) free[at] = 0;
      }
    }
  }
  for (const polygon of world.obstacles) {
    const box = extentOf(polygonEdges(polygon));
    const [firstRow, endRow] = clipped(box.bottom, box.top, y, rows), [first, last] = clipped(box.left, box.right, x, columns);
    for (let row = firstRow; row < endRow; row++) {
      for (let column = first; column < last; column++) if (isInside(x + (column + 0.5) * cell, y + (row + 0.5) * cell, polygon)) free[row * columns + column] = 0;
    }
  }
  return {x, y, cell, rows, columns, ...labelled(free, rows, columns)};
}

// Regions of free cells, connected diagonally too, numbered from 1 row by row; their sizes; and those that reach the border.
function labelled(free, rows, columns) {
  const labels = new Int32Array(free.length), stack = new Int32Array(free.length), sizes = [0], border = new Set([0]);
  for (let start = 0; start < free.length; start++) {
    if (!free[start] || labels[start]) continue;
    const label = sizes.length;
    let count = 1, size = 0;
    stack[0] = start;
    labels[start] = label;
    while (count) {
      const at = stack[--count], row = Math.floor(at / columns), column = at - row * columns;
      size++;
      if (row === 0 || column === 0 || row === rows - 1 || column === columns - 1) border.add(label);
      for (let r = Math.max(row - 1, 0); r <= Math.min(row + 1, rows - 1); r++) {
        for (let c = Math.max(column - 1, 0); c <= Math.min(column + 1, columns - 1); c++) {
          const next = r * columns + c;
          if (free[next] && !labels[next]) { labels[next] = label; stack[count++] = next; }
        }
      }
    }
    sizes.push(size);
  }
  return {labels, sizes, border};
}

function labelOf(space, x, y) {
  const column = Math.floor((x - space.x) / space.cell), row = Math.floor((y - space.y) / space.cell), {rows, columns, labels} = space;
  if (row < 0 || column < 0 || row >= rows || column >= columns) return 0;
  if (labels[row * columns + column]) return labels[row * columns + column];
  for (let r = Math.max(row - 1, 0); r <= Math.min(row + 1, rows - 1); r++) {
    for (let c = Math.max(column - 1, 0); c <= Math.min(column + 1, columns - 1); c++) if (labels[r * columns + c]) return labels[r * columns + c];
  }
  return 0;
}

// The cells that a robot covers from those regions, as a mask, and their area.
function covered(space, radius, isOf) {
  const {rows, columns, cell, labels} = space, mask = new Uint8Array(labels.length), reach = Math.ceil(radius / cell), disc = [];
  for (let i = -reach; i <= reach; i++) for (let j = -reach; j <= reach; j++) if (Math.sqrt((i * cell) ** 2 + (j * cell) ** 2) <= radius) disc.push([i, j]);
  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) {
      const at = row * columns + column;
      if (!isOf[labels[at]]) continue;
      mask[at] = 1;
      const isInner = row && column && row < rows - 1 && column < columns - 1 && isOf[labels[at - 1]] && isOf[labels[at + 1]] && isOf[labels[at - columns]] && isOf[labels[at + columns]];
      if (isInner) continue;
      for (const [i, j] of disc) if (row + i >= 0 && row + i < rows && column + j >= 0 && column + j < columns) mask[at + i * columns + j] = 1;
    }
  }
  return {mask, area: mask.reduce((sum, each) => sum + each, 0) * cell * cell};
}

// What is wrong with a world for a robot of a radius: {reason, words} and the number of the start it is about, or a
// reason of null; and the floor within reach (m^2), its share, and a mask of its cells.
function checked(world, radius) {
  const edges = edgesOf(world);
  if (!edges.length) return {reason: 'empty', words: 'There is no wall and no obstacle yet.'};
  const around = extentOf(edges), width = around.right - around.left, height = around.top - around.bottom;
  if (Math.max(width, height, ...Object.values(around).map(Math.abs)) > LARGEST) return {reason: 'far', words: `Walls reach further than ${LARGEST} m.`};
  const cell = Math.min(Math.max(CELL, Math.sqrt(((width + 4 * radius) * (height + 4 * radius)) / MAX_CELLS)), COARSEST * radius);
  const space = spaceOf(world, edges, around, radius, cell), wide = spaceOf(world, edges, around, radius - 0.75 * cell, cell);
  const closed = space.sizes.map((_, label) => !space.border.has(label));
  const largest = closed.reduce((best, isClosed, label) => (isClosed && space.sizes[label] > (best ? space.sizes[best] : 0) ? label : best), 0);
  const labels = world.starts.length ? world.starts.map(([x, y]) => labelOf(space, x, y)).filter(Boolean) : [largest].filter(Boolean);
  const reach = covered(space, radius, space.sizes.map((_, label) => labels.includes(label)));
  const enclosed = covered(space, radius, closed).area, isOpen = enclosed < OPEN_SHARE * width * height, floor = isOpen ? width * height : enclosed;
  const found = {reason: null, words: '', start: null, space, mask: reach.mask, area: reach.area, floor, isOpen, share: Math.min(reach.area / floor, 1)};
  const isOutside = (x, y) => { const label = labelOf(wide, x, y); return label === 0 || wide.border.has(label); };
  for (const [start, [x, y]] of world.starts.entries()) {
    const isIn = world.obstacles.some((polygon) => isInside(x, y, polygon)), gap = edges.reduce((least, edge) => Math.min(least, distanceTo(x, y, edge)), Infinity);
    if (isIn || gap < radius) return {...found, reason: 'collides', start, words: `Start ${start + 1} is ${isIn ? 'inside an obstacle' : `${gap.toFixed(2)} m from a wall: a robot of ${radius} m radius does not fit`}.`};
  }
  for (const [start, [x, y]] of world.starts.entries()) {
    if (isOutside(x, y)) return {...found, reason: 'open', start, words: `A robot could leave the world from start ${start + 1}: the outer wall is open. limslam worlds check says where.`};
  }
  if (!world.starts.length) {
    if (!largest) return {...found, reason: 'no room', words: 'No closed region has room for the robot. limslam worlds check says where the outline is open.'};
    const at = space.labels.indexOf(largest), row = Math.floor(at / space.columns);
    if (isOutside(space.x + (at - row * space.columns + 0.5) * cell, space.y + (row + 0.5) * cell)) return {...found, reason: 'open', words: 'A robot could leave the largest region: the outer wall is open.'};
  }
  return found;
}

function toml(world) {
  const number = (value) => (/[.e]/.test(String(value)) ? String(value) : `${value}.0`), row = (values) => `[${values.map(number).join(', ')}]`;
  const listed = (key, rows) => (rows.length || key === 'walls' ? [`${key} = [`, ...rows.map((each) => `    ${each},`), ']'] : []);
  const name = JSON.stringify(world.name.replace(/[\ud800-\udfff]/gu, '')).replace(/\x7f/g, '\\u007f');
  return `${[`name = ${name}`, `size = ${row(sizeOf(world))}`, ...Object.keys(KEYS).flatMap((key) => listed(key, world[key].map((each) => (key === 'obstacles' ? `[${each.map(row).join(', ')}]` : row(each)))))].join('\n')}\n`;
}

// That of the file, or larger if something was drawn beyond it.
function sizeOf(world) {
  const edges = edgesOf(world);
  if (!edges.length) return world.size || [1, 1];
  const {left, right, bottom, top} = extentOf(edges), [width, height] = world.size || [0, 0];
  return [Math.max(width, right, right - left, 0.01), Math.max(height, top, top - bottom, 0.01)];
}

// Reads what worlds in TOML are written in: keys with texts, numbers and lists.
function readToml(text) {
  const token = /\s+|#[^\n]*|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'|[-+]?\d[\d_]*(?:\.[\d_]+)?(?:[eE][-+]?\d+)?|[A-Za-z_][\w-]*|[=[\],]/y, tokens = [];
  while (token.lastIndex < text.length) {
    const at = token.lastIndex, found = token.exec(text);
    if (!found) throw new Error(`line ${text.slice(0, at).split('\n').length} cannot be read here; limslam worlds draw FILE reads all of TOML`);
    if (!/^[\s#]/.test(found[0])) tokens.push(found[0]);
  }
  let next = 0;
  const value = () => {
    const word = tokens[next++];
    if (word === '[') {
      const list = [];
      while (next < tokens.length && tokens[next] !== ']') {
        list.push(value());
        if (tokens[next] === ',') next++; else if (tokens[next] !== ']') throw new Error('a list does not end');
      }
      next++;
      return list;
    }
    if (word && word[0] === '"') return JSON.parse(word);
    if (word && word[0] === "'") return word.slice(1, -1);
    if (!word || !/^[-+\d]/.test(word)) throw new Error(`${word || 'the end of the file'} is no value`);
    return Number(word.replace(/_/g, ''));
  };
  const table = {};
  while (next < tokens.length) {
    const key = tokens[next++];
    if (tokens[next++] !== '=') throw new Error(`${key} has no value`);
    table[key] = value();
  }
  return worldOf(table);
}

// A world with all of its keys; an error in words where a table is none.
function worldOf(table) {
  const unknown = Object.keys(table).find((key) => !(Object.hasOwn(KEYS, key) || key === 'name' || key === 'size'));
  if (unknown) throw new Error(`a world has no key ${unknown}`);
  if (typeof table.name !== 'string' || !Array.isArray(table.walls)) throw new Error('a world has a name and walls');
  const rows = (list, width) => Array.isArray(list) && list.every((row) => Array.isArray(row) && row.length === width && row.every(Number.isFinite));
  const world = {name: table.name, size: table.size || null};
  if (world.size && !rows([world.size], 2)) throw new Error('size must be two numbers');
  for (const [key, width] of Object.entries(KEYS)) {
    world[key] = table[key] || [];
    const isGood = key === 'obstacles' ? Array.isArray(world[key]) && world[key].every((polygon) => rows(polygon, 2) && polygon.length > 2) : rows(world[key], width);
    if (!isGood) throw new Error(`${key} must be lists of ${width} numbers`);
  }
  return world;
}

// The parts of a stretch that no other stretch on its line covers.
function without(stretch, others) {
  const [x1, y1, x2, y2] = stretch, length = Math.hypot(x2 - x1, y2 - y1), ex = (x2 - x1) / length, ey = (y2 - y1) / length;
  let parts = [[0, length]];
  for (const other of others) {
    const [from, to] = [0, 2].map((at) => (other[at] - x1) * ex + (other[at + 1] - y1) * ey).sort((a, b) => a - b);
    if ([0, 2].some((at) => Math.abs((other[at + 1] - y1) * ex - (other[at] - x1) * ey) > 1e-5)) continue;
    parts = parts.flatMap(([a, b]) => [[a, Math.min(b, from)], [Math.max(a, to), b]].filter(([c, d]) => d - c > 1e-5));
  }
  const at = (along) => (along === 0 ? [x1, y1] : along === length ? [x2, y2] : [tidy(x1 + along * ex), tidy(y1 + along * ey)]);
  return parts.map(([a, b]) => [...at(a), ...at(b)]);
}

const tidy = (value) => Math.round(value * 1e6) / 1e6;
