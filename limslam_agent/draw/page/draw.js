// The page on which a world is drawn. rules.js, which comes before, has the file and the check.

const byId = (id) => document.getElementById(id);
const NEAR = 10;  // pixels within which a corner attracts a point, and a click selects
const LISTED = 300;  // things in the list
const TOOLS = {
  select: {key: 'v', title: 'Select', hint: 'Click what is drawn to select it. Drag it, or one of its corners, to move it.'},
  room: {key: 'r', title: 'Room', hint: 'Drag from one corner of a room to the opposite one, or click both.'},
  wall: {key: 'w', title: 'Wall', hint: 'Click corner after corner. A click on the last one, or Esc, ends the row.'},
  door: {key: 'd', title: 'Door', hint: 'Click both ends of an opening in a wall, or drag.'},
  obstacle: {key: 'o', title: 'Obstacle', hint: 'Drag a box, or click the corners of a polygon and then the first one again.'},
  start: {key: 's', title: 'Start', hint: 'Click where a robot starts, and then where it looks, or drag.'},
  picture: {key: 'p', title: 'Scale picture', hint: 'Click two points whose distance you know. The first one moves onto the grid. Drag to move the picture.'},
};
const KINDS = {walls: 'Wall', doors: 'Door', obstacles: 'Obstacle', starts: 'Start'};
const LABELS = {walls: ['x1', 'y1', 'x2', 'y2'], doors: ['x1', 'y1', 'x2', 'y2'], starts: ['x', 'y', 'looks to, deg']};

const given = JSON.parse(byId('data').textContent);
let world = worldOf(given.world), picture = null, selected = null, tool = 'room', pending = [], cursor = [0, 0], found = null, isSaved = true;
let past = [], future = [], drag = null, view = {x: 2.5, y: 2, scale: 80}, colours = {}, reachLayer = null, checking = 0;
const pointers = new Map();
const canvas = byId('plan'), pen = canvas.getContext('2d');

function element(name, children = [], attributes = {}) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...[].concat(children));
  return made;
}

// ---- changes of the world ----

const copy = () => ({world: structuredClone(world), place: picture && {...picture.place}});

function change(action) {
  const before = copy();
  action();
  past.push(before);
  future = [];
  changed();
}

function changed() {
  isSaved = false;
  found = null;
  reachLayer = null;
  clearTimeout(checking);
  checking = setTimeout(check, 150);
  listAll();
  show();
}

function step(from, to) {
  if (!from.length) return;
  to.push(copy());
  const state = from.pop();
  world = state.world;
  if (picture && state.place) picture.place = state.place;
  selected = null;
  pending = [];
  changed();
}

const boxOf = ([x1, y1], [x2, y2]) => [[x1, y1], [x2, y1], [x2, y2], [x1, y2]];
const same = (a, b) => a && b && Math.hypot(a[0] - b[0], a[1] - b[1]) < 1e-6;
const addWalls = (walls) => walls.forEach((wall) => world.walls.push(...without(wall, [...world.walls, ...world.doors])));

// What a tool makes of its points; drag: of a press and a release at two places.
function finish(points, isDrag) {
  const [a, b] = points, stretch = [...a, ...b];
  if (tool === 'room' && a[0] !== b[0] && a[1] !== b[1]) change(() => addWalls(polygonEdges(boxOf(a, b))));
  if (tool === 'wall') change(() => addWalls([stretch]));
  if (tool === 'door') change(() => { world.walls = world.walls.flatMap((wall) => without(wall, [stretch])); world.doors.push(stretch); });
  if (tool === 'obstacle' && (!isDrag || (a[0] !== b[0] && a[1] !== b[1]))) change(() => world.obstacles.push(isDrag ? boxOf(a, b) : points));
  if (tool === 'start') change(() => world.starts.push([...a, tidy(Math.atan2(b[1] - a[1], b[0] - a[0]))]));
  if (tool === 'picture') askScale(a, b);
  say({room: 'Room', wall: 'Wall', door: 'Door', obstacle: 'Obstacle', start: 'Start'}[tool] ? `${TOOLS[tool].title} drawn.` : '');
}

// A point by a click or by Enter.
function setPoint(point) {
  const last = pending.at(-1), first = pending[0];
  if (!pending.length) pending = [point];
  else if (tool === 'obstacle') {
    if (same(point, first)) { if (pending.length > 2) finish(pending, false); pending = []; }
    else if (!same(point, last)) pending.push(point);
  } else if (tool === 'start') { finish([first, point], false); pending = []; }
  else if (same(point, last)) pending = [];
  else {
    finish([last, point], false);
    pending = tool === 'wall' && !same(point, first) ? [...pending, point] : [];
  }
  show();
}

const pointsOf = ({kind, index}) => {
  const thing = world[kind][index];
  return kind === 'obstacles' ? thing : kind === 'starts' ? [thing.slice(0, 2)] : [thing.slice(0, 2), thing.slice(2)];
};

// Move the selected thing, or one of its corners; walls and doors that end in that corner follow.
function move(thing, corner, dx, dy) {
  const shifted = ([x, y]) => [tidy(x + dx), tidy(y + dy)];
  if (corner === null || thing.kind === 'starts') {
    const row = world[thing.kind][thing.index];
    world[thing.kind][thing.index] = thing.kind === 'obstacles' ? row.map(shifted) : thing.kind === 'starts' ? [...shifted(row), row[2]] : [...shifted(row), ...shifted(row.slice(2))];
    return;
  }
  const from = pointsOf(thing)[corner], to = shifted(from);
  if (thing.kind === 'obstacles') world.obstacles[thing.index][corner] = to;
  else for (const kind of ['walls', 'doors']) world[kind] = world[kind].map((row) => [0, 2].flatMap((at) => (same(row.slice(at, at + 2), from) ? to : row.slice(at, at + 2))));
}

// What has lost its length in a move goes.
function clean() {
  for (const kind of ['walls', 'doors']) world[kind] = world[kind].filter((row) => !same(row, row.slice(2)));
  world.obstacles = world.obstacles.map((polygon) => polygon.filter((corner, index) => !same(corner, polygon[(index + 1) % polygon.length]))).filter((polygon) => polygon.length > 2);
  if (selected && !world[selected.kind][selected.index]) selected = null;
}

function remove() {
  if (selected) change(() => { world[selected.kind].splice(selected.index, 1); selected = null; });
}

// ---- the picture of a plan ----

function loadPicture(address, name) {
  const image = new Image();
  image.onload = () => {
    // Until two points say more, it is ten metres wide.
    picture = {image, place: {x: 0, y: 0, scale: 10 / image.naturalWidth}};
    byId('show-picture').checked = true;
    choose('picture');
    fit();
    document.body.dataset.picture = 'ready';
  };
  image.onerror = () => say(`${name}: this browser cannot show that picture`, true);
  image.src = address;
}

function askScale(a, b) {
  const dialog = byId('scale-dialog');
  // The event of the form, not that of the dialog: a browser sends 'close' some time after the click.
  dialog.querySelector('form').onsubmit = ({submitter}) => {
    const metres = Number(byId('metres').value);
    if (submitter.value !== 'scale' || !(metres > 0)) return;
    const factor = metres / Math.hypot(b[0] - a[0], b[1] - a[1]), {x, y, scale} = picture.place, to = onGrid(a);
    change(() => { picture.place = {x: to[0] + (x - a[0]) * factor, y: to[1] + (y - a[1]) * factor, scale: scale * factor}; });
    fit();
  };
  dialog.showModal();
}

// ---- places ----

const toPixels = ([x, y]) => [canvas.clientWidth / 2 + (x - view.x) * view.scale, canvas.clientHeight / 2 - (y - view.y) * view.scale];
const toWorld = ([u, v]) => [view.x + (u - canvas.clientWidth / 2) / view.scale, view.y - (v - canvas.clientHeight / 2) / view.scale];
const gridStep = () => Number(byId('step').value);
const onGrid = (point) => point.map((value) => tidy(Math.round(value / gridStep()) * gridStep()));

function snapped(raw, isFree) {
  if (isFree || tool === 'picture') return raw.map(tidy);
  const corners = [...pending, ...Object.keys(KINDS).filter((kind) => kind !== 'starts').flatMap((kind) => world[kind].flatMap((_, index) => pointsOf({kind, index})))];
  const near = corners.map((corner) => [Math.hypot(corner[0] - raw[0], corner[1] - raw[1]) * view.scale, corner]).filter(([gap]) => gap < NEAR).sort((a, b) => a[0] - b[0])[0];
  if (near) return [...near[1]];
  const point = onGrid(raw);
  if (tool !== 'door') return point;
  const wall = world.walls.map((each) => [distanceTo(...raw, each), each]).sort((a, b) => a[0] - b[0])[0];
  if (!wall || wall[0] * view.scale > 2 * NEAR) return point;
  const [x1, y1, x2, y2] = wall[1], share = shareAlong(...point, wall[1]);
  return [tidy(x1 + share * (x2 - x1)), tidy(y1 + share * (y2 - y1))];
}

// The thing, and its corner if one is meant, at a place.
function thingAt(raw) {
  const reach = NEAR / view.scale, gap = ([x, y]) => Math.hypot(x - raw[0], y - raw[1]);
  if (selected) {
    const corner = pointsOf(selected).findIndex((point) => gap(point) < reach);
    if (corner >= 0) return {thing: selected, corner};
  }
  for (const kind of ['starts', 'doors', 'walls', 'obstacles']) {
    const index = world[kind].findLastIndex((row) => (kind === 'starts' ? gap(row) < Math.max(reach, radius()) : kind === 'obstacles' ? isInside(...raw, row) || polygonEdges(row).some((edge) => distanceTo(...raw, edge) < reach) : distanceTo(...raw, row) < reach));
    if (index >= 0) return {thing: {kind, index}, corner: null};
  }
  return null;
}

function fit() {
  const box = extentOf([...edgesOf(world), ...world.starts.map(([x, y]) => [x, y, x, y]), ...(picture ? [[picture.place.x, picture.place.y, picture.place.x + picture.image.naturalWidth * picture.place.scale, picture.place.y + picture.image.naturalHeight * picture.place.scale]] : [])]);
  if (!Number.isFinite(box.left)) Object.assign(box, {left: 0, bottom: 0, right: 6, top: 4});
  const scale = Math.min((canvas.clientWidth - 60) / Math.max(box.right - box.left, 0.5), (canvas.clientHeight - 60) / Math.max(box.top - box.bottom, 0.5));
  view = {x: (box.left + box.right) / 2, y: (box.bottom + box.top) / 2, scale: Math.min(Math.max(scale, 0.5), 400)};
  show();
}

function zoomBy(factor, [u, v] = [canvas.clientWidth / 2, canvas.clientHeight / 2]) {
  const [x, y] = toWorld([u, v]);
  view.scale = Math.min(Math.max(view.scale * factor, 0.5), 2000);
  const [left, top] = toPixels([x, y]);
  view.x += (left - u) / view.scale;
  view.y -= (top - v) / view.scale;
  show();
}

// ---- what is seen ----

function show() {
  const ratio = devicePixelRatio, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) Object.assign(canvas, {width: Math.round(width * ratio), height: Math.round(height * ratio)});
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  if (picture && byId('show-picture').checked) {
    const {x, y, scale} = picture.place, {naturalWidth, naturalHeight} = picture.image, [u, v] = toPixels([x, y + naturalHeight * scale]);
    pen.globalAlpha = 0.5;
    pen.drawImage(picture.image, u, v, naturalWidth * scale * view.scale, naturalHeight * scale * view.scale);
    pen.globalAlpha = 1;
  }
  if (byId('show-reach').checked) drawReach();
  drawGrid(width, height);
  for (const polygon of world.obstacles) trace(polygon, colours.occupied, 1.5, {fill: colours.occupied, close: true});
  for (const row of world.walls) trace([row.slice(0, 2), row.slice(2)], colours.ink, 3);
  for (const row of world.doors) trace([row.slice(0, 2), row.slice(2)], colours.frontierInk, 3, {dash: [6, 5]});
  world.starts.forEach(drawStart);
  if (selected) drawSelected();
  drawPending();
}

function trace(points, colour, width, {fill = null, close = false, dash = []} = {}) {
  pen.beginPath();
  for (const point of points) pen.lineTo(...toPixels(point));
  if (close) pen.closePath();
  if (fill) { pen.fillStyle = fill; pen.globalAlpha = 0.6; pen.fill(); pen.globalAlpha = 1; }
  Object.assign(pen, {strokeStyle: colour, lineWidth: width, lineCap: 'round'});
  pen.setLineDash(dash);
  pen.stroke();
  pen.setLineDash([]);
}

function drawGrid(width, height) {
  const [left, top] = toWorld([0, 0]), [right, bottom] = toWorld([width, height]);
  // Lines that would stand closer than 8 pixels are left out.
  const fine = [gridStep(), 0.1, 0.5, 1, 5, 10, 50, 100].find((size) => size * view.scale >= 8) || 100, coarse = [1, 5, 10, 50, 100].find((size) => size * view.scale >= 40) || 500;
  for (const [size, alpha] of [[fine, 0.5], [coarse, 1]]) {
    pen.beginPath();
    for (let x = Math.ceil(left / size); x <= right / size; x++) { const [u] = toPixels([x * size, 0]); pen.moveTo(u, 0); pen.lineTo(u, height); }
    for (let y = Math.ceil(bottom / size); y <= top / size; y++) { const [, v] = toPixels([0, y * size]); pen.moveTo(0, v); pen.lineTo(width, v); }
    Object.assign(pen, {strokeStyle: colours.rule, lineWidth: 1, globalAlpha: alpha});
    pen.stroke();
  }
  Object.assign(pen, {globalAlpha: 1, fillStyle: colours.text, font: '11px system-ui, sans-serif'});
  for (let x = Math.ceil(left / coarse); x <= right / coarse; x++) pen.fillText(`${tidy(x * coarse)}${x === 0 ? ' m' : ''}`, toPixels([x * coarse, 0])[0] + 3, height - 4);
  for (let y = Math.ceil(bottom / coarse); y <= top / coarse; y++) if (toPixels([0, y * coarse])[1] < height - 24) pen.fillText(String(tidy(y * coarse)), 3, toPixels([0, y * coarse])[1] - 3);
}

function drawReach() {
  if (!found || !found.mask) return;
  const {space, mask} = found, {rows, columns} = space;
  if (!reachLayer) {
    reachLayer = element('canvas', [], {width: columns, height: rows});
    const layer = reachLayer.getContext('2d'), data = layer.createImageData(columns, rows), bytes = new Uint32Array(data.data.buffer);
    layer.fillStyle = found.reason ? colours.bad : colours.good;
    layer.fillRect(0, 0, 1, 1);
    const [red, green, blue] = layer.getImageData(0, 0, 1, 1).data, tint = ((70 << 24) | (blue << 16) | (green << 8) | red) >>> 0;
    for (let at = 0; at < mask.length; at++) if (mask[at]) bytes[(rows - 1 - Math.floor(at / columns)) * columns + (at % columns)] = tint;
    layer.putImageData(data, 0, 0);
  }
  const [u, v] = toPixels([space.x, space.y + rows * space.cell]);
  pen.drawImage(reachLayer, u, v, columns * space.cell * view.scale, rows * space.cell * view.scale);
}

function drawStart([x, y, theta], index) {
  const [u, v] = toPixels([x, y]), size = Math.max(radius() * view.scale, 5);
  pen.beginPath();
  pen.arc(u, v, size, 0, 7);
  pen.fillStyle = colours[`robot${(index % 6) + 1}`];
  pen.fill();
  pen.beginPath();
  pen.moveTo(u, v);
  pen.lineTo(u + 1.8 * size * Math.cos(theta), v - 1.8 * size * Math.sin(theta));
  Object.assign(pen, {strokeStyle: colours.ink, lineWidth: 2});
  pen.stroke();
}

function drawSelected() {
  const points = pointsOf(selected);
  if (selected.kind !== 'starts') trace(points, colours.accent, 3, {close: selected.kind === 'obstacles'});
  for (const point of points) {
    pen.beginPath();
    pen.arc(...toPixels(point), 6, 0, 7);
    Object.assign(pen, {fillStyle: colours.card, strokeStyle: colours.accent, lineWidth: 2});
    pen.fill();
    pen.stroke();
  }
}

function drawPending() {
  const from = drag?.start && drag.isMoved ? [drag.start] : tool === 'wall' || tool === 'obstacle' ? pending : pending.slice(-1);
  const isBox = tool === 'room' || (tool === 'obstacle' && drag?.isMoved);
  if (from.length && tool !== 'select') trace(isBox ? boxOf(from[0], cursor) : tool === 'wall' ? [from.at(-1), cursor] : [...from, cursor], colours.accent, 2, {close: isBox, dash: [4, 4]});
  if (tool === 'select' && document.activeElement !== canvas) return;
  const [u, v] = toPixels(cursor);
  pen.beginPath();
  for (const [du, dv] of [[7, 0], [0, 7]]) { pen.moveTo(u - du, v - dv); pen.lineTo(u + du, v + dv); }
  Object.assign(pen, {strokeStyle: colours.accent, lineWidth: 1.5});
  pen.stroke();
  const last = from.at(-1), text = cursor.map((value) => value.toFixed(2));
  byId('place').textContent = `x ${text[0]}, y ${text[1]} m${last ? `, ${Math.hypot(cursor[0] - last[0], cursor[1] - last[1]).toFixed(2)} m long` : ''}`;
}

// ---- panels ----

const radius = () => Math.min(Math.max(Number(byId('radius').value) || 0.1, 0.02), 10);
const metres = (value) => String(Math.round(value * 1000) / 1000);

function check() {
  found = checked(world, radius());
  reachLayer = null;
  const {reason, words, share, area, floor, isOpen} = found, isSmall = share < SMALL_SHARE;
  const [kind, text] = reason ? ['bad', words] : isOpen ? ['warn', 'The outer wall is open, so most of the floor cannot be used.'] : isSmall ? ['warn', 'Most of the floor cannot be reached.'] : ['good', 'A robot can be used here.'];
  byId('verdict').className = `verdict ${kind}`;
  byId('verdict').textContent = text;
  byId('reach').textContent = reason === 'open' ? 'Shaded: where the robot could go.' : area === undefined ? '' : `${area.toFixed(1)} m\u00b2 of ${floor.toFixed(1)} m\u00b2 of floor within reach (shaded).`;
  byId('text').textContent = toml(world);
  document.body.dataset.checked = reason || 'ok';
  show();
}

function describe(kind, index) {
  const row = world[kind][index], size = kind === 'walls' || kind === 'doors' ? `, ${Math.hypot(row[2] - row[0], row[3] - row[1]).toFixed(2)} m` : '';
  const place = pointsOf({kind, index}).slice(0, 2).map((point) => `(${point.map(metres).join(', ')})`).join(kind === 'obstacles' ? ', ' : ' to ');
  return `${KINDS[kind]} ${index + 1}: ${place}${kind === 'obstacles' ? ' ...' : size}`;
}

function listAll() {
  const all = Object.keys(KINDS).flatMap((kind) => world[kind].map((_, index) => ({kind, index})));
  byId('count').textContent = all.length > LISTED ? `${all.length}, the first ${LISTED}` : all.length || '';
  byId('drawn').replaceChildren(...all.slice(0, LISTED).map((thing) => {
    const button = element('button', describe(thing.kind, thing.index), {type: 'button', 'aria-pressed': String(selected?.kind === thing.kind && selected.index === thing.index)});
    button.addEventListener('click', () => { choose('select'); select(thing); });
    return element('li', button);
  }));
  byId('undo').disabled = !past.length;
  byId('redo').disabled = !future.length;
  if (document.activeElement?.dataset.field === undefined) listSelected();
}

function listSelected() {
  if (!selected) return byId('selected').replaceChildren(element('p', 'Nothing. Choose from the list, or click it with Select.', {class: 'note'}));
  const {kind, index} = selected, row = kind === 'obstacles' ? world[kind][index].flat() : world[kind][index];
  const fields = row.map((value, at) => {
    const isAngle = kind === 'starts' && at === 2, shown = isAngle ? tidy((value * 180) / Math.PI) : value;
    const input = element('input', [], {type: 'number', step: isAngle ? 5 : gridStep(), value: Math.round(shown * 1e4) / 1e4, 'data-field': at});
    input.addEventListener('change', () => {
      const number = Number(input.value);
      if (input.value === '' || !Number.isFinite(number) || Math.abs(number) > LARGEST) { input.value = shown; return; }
      change(() => {
        const target = kind === 'obstacles' ? world[kind][index][Math.floor(at / 2)] : world[kind][index];
        target[kind === 'obstacles' ? at % 2 : at] = isAngle ? tidy((number * Math.PI) / 180) : number;
        clean();
      });
    });
    return element('label', [kind === 'obstacles' ? `${'xy'[at % 2]}${Math.floor(at / 2) + 1}` : LABELS[kind][at], input]);
  });
  const button = element('button', 'Delete', {type: 'button'});
  button.addEventListener('click', remove);
  byId('selected').replaceChildren(element('p', describe(kind, index), {class: 'note'}), element('div', fields, {class: 'fields'}), button);
}

function select(thing) {
  selected = thing;
  if (thing) say(describe(thing.kind, thing.index));
  listAll();
  listSelected();
  show();
}

function choose(name) {
  tool = name;
  pending = [];
  if (name !== 'select') selected = null;
  for (const button of byId('tools').children) {
    button.setAttribute('aria-pressed', String(button.dataset.tool === name));
    button.hidden = button.dataset.tool === 'picture' && !picture;
  }
  byId('picture-shown').hidden = !picture;
  byId('hint').textContent = TOOLS[name].hint;
  canvas.style.cursor = name === 'select' ? 'default' : 'crosshair';
  listAll();
  listSelected();
  show();
}

function say(words, isShown = false) {
  byId('spoken').textContent = words;
  if (isShown) byId('hint').textContent = words;
}

// ---- files ----

function save() {
  const name = (world.name.normalize('NFKD').replace(/[^A-Za-z0-9_.-]+/g, '_').replace(/^[._]+|_+$/g, '') || 'world').slice(0, 80);
  const link = element('a', [], {href: URL.createObjectURL(new Blob([toml(world)], {type: 'application/toml'})), download: `${name}.toml`});
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
  isSaved = true;
  say(`Saved ${name}.toml.`, true);
}

async function openFile(file) {
  try {
    const read = readToml(await file.text());
    change(() => { world = read; selected = null; pending = []; });
    byId('name').value = world.name;
    isSaved = true;
    say(`Opened ${file.name}.`, true);
    fit();
  } catch (error) {
    say(`${file.name}: ${error.message}`, true);
  }
}

// ---- hands ----

function onPointer() {
  const at = (event) => [event.offsetX, event.offsetY];
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, at(event));
    const raw = toWorld(at(event));
    if (pointers.size > 1) { drag = {pan: true}; return; }
    cursor = snapped(raw, event.altKey);
    drag = {start: cursor, pixels: at(event), isMoved: false, pan: event.button === 1, before: copy()};
    if (tool !== 'select' || drag.pan) return;
    const hit = thingAt(raw);
    select(hit && hit.thing);
    drag.pan = !hit;
    drag.hit = hit;
    drag.last = onGrid(raw);
  });
  canvas.addEventListener('pointermove', (event) => {
    const before = pointers.get(event.pointerId), now = at(event), raw = toWorld(now);
    if (before && pointers.size > 1) {
      const [, other] = [...pointers].find(([id]) => id !== event.pointerId), apart = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]);
      zoomBy(apart(now) / Math.max(apart(before), 1), other);
    } else if (before && drag) dragged(before, now, raw, event.altKey);
    else if (tool !== 'select') cursor = snapped(raw, event.altKey);
    if (before) pointers.set(event.pointerId, now);
    show();
  });
  canvas.addEventListener('pointerup', (event) => {
    pointers.delete(event.pointerId);
    if (!drag || pointers.size) return;
    const {pan, hit, isMoved, start, before} = drag;
    drag = null;
    if (hit && isMoved) { clean(); past.push(before); future = []; changed(); listSelected(); }
    if (pan || tool === 'select') return;
    if (!isMoved) setPoint(start);
    else {
      pending = [];
      if (tool === 'picture') { past.push(before); future = []; changed(); }
      else if (!same(start, cursor)) finish([start, cursor], true);
      show();
    }
  });
  canvas.addEventListener('pointercancel', (event) => { pointers.delete(event.pointerId); drag = null; });
  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    zoomBy(Math.exp(-0.0015 * event.deltaY), at(event));
  }, {passive: false});
}

function dragged(before, now, raw, isFree) {
  if (!drag.isMoved && Math.hypot(now[0] - drag.pixels?.[0], now[1] - drag.pixels?.[1]) < 5) return;
  drag.isMoved = true;
  const dx = (now[0] - before[0]) / view.scale, dy = (before[1] - now[1]) / view.scale;
  if (drag.pan) Object.assign(view, {x: view.x - dx, y: view.y - dy});
  else if (tool === 'picture') Object.assign(picture.place, {x: picture.place.x + dx, y: picture.place.y + dy});
  else if (drag.hit) {
    const from = drag.hit.corner === null ? drag.last : pointsOf(selected)[drag.hit.corner], to = isFree ? raw : onGrid(raw);
    move(selected, drag.hit.corner, to[0] - from[0], to[1] - from[1]);
    drag.last = to;
  } else cursor = snapped(raw, isFree);
}

function onKey(press) {
  const isCommand = press.ctrlKey || press.metaKey, key = press.key.toLowerCase();
  const commands = {z: () => (press.shiftKey ? step(future, past) : step(past, future)), y: () => step(future, past), s: save};
  if (document.querySelector('dialog[open]') || press.altKey) return;
  const isField = ['INPUT', 'SELECT'].includes(press.target.tagName) && press.target.type !== 'checkbox';
  if (isCommand && key in commands && !(isField && key !== 's')) { press.preventDefault(); commands[key](); return; }
  if (isCommand || isField) return;
  const arrows = {arrowleft: [-1, 0], arrowright: [1, 0], arrowup: [0, 1], arrowdown: [0, -1]};
  const actions = {
    escape: () => { pending = []; select(null); }, delete: remove, backspace: remove, '+': () => zoomBy(1.4), '=': () => zoomBy(1.4), '-': () => zoomBy(1 / 1.4), f: fit,
    t: () => byId('theme').click(), '?': () => byId('help').click(), ...Object.fromEntries(Object.entries(TOOLS).filter(([name]) => name !== 'picture' || picture).map(([name, {key: letter}]) => [letter, () => choose(name)])),
  };
  if (press.target === canvas) {
    actions.enter = () => (tool === 'select' ? select(thingAt(cursor)?.thing || null) : setPoint([...cursor]));
    actions[' '] = actions.enter;
    for (const [name, [dx, dy]] of Object.entries(arrows)) actions[name] = () => steer((press.shiftKey ? 10 : 1) * dx * gridStep(), (press.shiftKey ? 10 : 1) * dy * gridStep());
  }
  if (!Object.hasOwn(actions, key)) return;
  press.preventDefault();
  actions[key]();
}

function steer(dx, dy) {
  if (tool === 'select' && selected) { change(() => move(selected, null, dx, dy)); say(describe(selected.kind, selected.index)); return; }
  cursor = onGrid([cursor[0] + dx, cursor[1] + dy]);
  const [u, v] = toPixels(cursor);
  if (u < 0 || v < 0 || u > canvas.clientWidth || v > canvas.clientHeight) [view.x, view.y] = cursor;
  say(`x ${metres(cursor[0])}, y ${metres(cursor[1])}`);
  show();
}

const systemIsDark = matchMedia('(prefers-color-scheme: dark)');
function applyTheme(theme) {
  document.documentElement.dataset.theme = theme || (systemIsDark.matches ? 'dark' : 'light');
  const style = getComputedStyle(document.documentElement), names = ['ink', 'text', 'rule', 'card', 'accent', 'occupied', 'frontierInk', 'good', 'bad', ...[1, 2, 3, 4, 5, 6].map((number) => `robot${number}`)];
  colours = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  byId('theme').setAttribute('aria-pressed', String(document.documentElement.dataset.theme === 'dark'));
  reachLayer = null;
}

function begin() {
  let theme = null;
  try { theme = localStorage.getItem('limslam-theme'); } catch { /* a file may not read anything */ }
  applyTheme(theme);
  systemIsDark.addEventListener('change', () => { applyTheme(theme); show(); });
  for (const [name, {key, title}] of Object.entries(TOOLS)) {
    const button = element('button', title, {type: 'button', 'data-tool': name, title: `${title} (${key})`, 'aria-pressed': 'false', 'aria-keyshortcuts': key});
    button.addEventListener('click', () => choose(name));
    byId('tools').append(button);
    byId('keys').append(element('tr', [element('th', element('kbd', key), {scope: 'row'}), element('td', `${title}. ${TOOLS[name].hint}`)]));
  }
  const on = (id, action, kind = 'click') => byId(id).addEventListener(kind, action);
  on('save', save);
  on('open', () => { if (isSaved || confirm('What is drawn has not been saved. Open another world?')) byId('file').click(); });
  on('file', () => { if (byId('file').files[0]) openFile(byId('file').files[0]); byId('file').value = ''; }, 'change');
  on('picture', () => byId('picture-file').click());
  on('picture-file', () => { const [file] = byId('picture-file').files; if (file) loadPicture(URL.createObjectURL(file), file.name); }, 'change');
  on('undo', () => step(past, future));
  on('redo', () => step(future, past));
  on('zoom-in', () => zoomBy(1.4));
  on('zoom-out', () => zoomBy(1 / 1.4));
  on('fit', fit);
  on('help', () => byId('help-dialog').showModal());
  on('theme', () => {
    theme = document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark';
    try { localStorage.setItem('limslam-theme', theme); } catch { /* a file may not store anything */ }
    applyTheme(theme);
    show();
  });
  for (const id of ['step', 'show-picture', 'show-reach']) on(id, show, 'change');
  on('radius', check, 'change');
  on('name', () => { world.name = byId('name').value; isSaved = false; byId('text').textContent = toml(world); }, 'input');
  document.addEventListener('keydown', onKey);
  for (const kind of ['focus', 'blur']) canvas.addEventListener(kind, show);
  addEventListener('resize', show);
  addEventListener('beforeunload', (event) => { if (!isSaved) event.preventDefault(); });
  onPointer();
  byId('name').value = world.name;
  byId('radius').value = given.radius;
  choose(edgesOf(world).length ? 'select' : 'room');
  fit();
  check();
  if (given.picture) loadPicture(given.picture, 'the picture');
  document.body.dataset.state = 'ready';
}

begin();
