
// The panels beside the pictures: numbers and tables of the moment.

const STAGES = ['predict', 'collect', 'find lines', 'associate', 'correct or add', 'close loops', 'explore'];
const KINDS = {
  new: {name: 'new walls', stages: [3, 4], weight: 5, shown: true, colour: 'good'},
  again: {name: 'walls seen again', stages: [3, 4], weight: 2, shown: false, colour: 'wall'},
  loop: {name: 'loops', stages: [5], weight: 7, shown: true, colour: 'plan'},
  waits: {name: 'lines that wait', stages: [3], weight: 1, shown: false, colour: 'faint'},
  hough: {name: 'extractions', stages: [2], weight: 1, shown: false, colour: 'right'},
  goal: {name: 'goals', stages: [6], weight: 4, shown: true, colour: 'frontierInk'},
  status: {name: 'status', stages: [], weight: 8, shown: true, colour: 'bad'},
  place: {name: 'places', stages: [], weight: 8, shown: true, colour: 'bad'},
  restart: {name: 'restarts', stages: [], weight: 8, shown: true, colour: 'bad'},
  kidnap: {name: 'kidnappings', stages: [], weight: 9, shown: true, colour: 'bad'},
  handover: {name: 'hand-overs', stages: [], weight: 9, shown: true, colour: 'bad'},
};
const TESTS = {
  direction: 'direction', offset: 'offset', ends: 'gap along the wall', range: 'out of range', hidden: 'beams cannot see it',
  beams: 'these beams cannot show it', side: 'seen from the other side only', gate: 'gate',
};

const byId = (id) => document.getElementById(id);

function element(tag, content = '', attributes = {}) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (content instanceof Array) made.append(...content); else made.textContent = content;
  return made;
}

function table(caption, heads, rows) {
  const head = element('tr', heads.map((text) => element('th', text, {scope: 'col'})));
  const lines = rows.map(({cells, mark}) => {
    const [first, ...others] = cells;
    const row = element('tr', [element('th', first, {scope: 'row'}), ...others.map((text) => element('td', text))]);
    if (mark) row.className = mark;
    return row;
  });
  const made = element('table', [element('caption', caption), element('thead', [head]), element('tbody', lines)]);
  return element('div', [made], {class: 'scroll', tabindex: '0'});
}

const number = (value, digits, unit = '') => (Number.isFinite(value) ? `${value.toFixed(digits)}${unit}` : '\u2013');
const degrees = (angle) => (angle * 180) / Math.PI;

// An event in a few words.
function wordsOf(event, robots) {
  const who = robots > 1 && event.robot !== undefined ? `robot ${event.robot + 1}: ` : '';
  const texts = {
    new: () => `new wall ${event.wall}`,
    again: () => `wall ${event.wall} seen again`,
    loop: () => `loop closed: wall ${event.wall} is wall ${event.other}`,
    waits: () => `line waits`,
    hough: () => `${event.side === 'none' ? 'beams ahead' : `${event.side} buffer`}: ${event.lines.length === 1 ? '1 line' : `${event.lines.length} lines`} found`,
    goal: () => `new goal at (${event.goal.map((value) => value.toFixed(1)).join(', ')})`,
  };
  return who + (texts[event.kind] ? texts[event.kind]() : event.words);
}

// Headline and explanation of the moment: the most important event of the last second or two.
function captionOf(recording, frame, window) {
  const now = recording.seconds[frame], until = recording.eventsUntil(frame);
  let best = null;
  for (let i = until - 1; i >= 0 && now - recording.events[i].t <= window; i--) {
    const event = recording.events[i];
    if (!best || KINDS[event.kind].weight > KINDS[best.kind].weight) best = event;
  }
  const lessons = recording.meta.lessons;
  if (!best) {
    const [headline, explanation] = frame === 0 ? lessons.start : lessons.drive;
    return {stages: frame === 0 ? [] : [0, 1], headline, explanation};
  }
  const [lesson, explanation] = lessons[best.kind];
  const topic = lesson.split(':')[0];
  const isWaiting = best.kind === 'waits', words = wordsOf(best, recording.robots);
  const headline = {loop: `Close the loop: ${words.split(': ')[1]}.`, waits: lesson}[best.kind];
  return {
    stages: KINDS[best.kind].stages,
    headline: headline || `${topic}: ${words}.`,
    explanation: isWaiting ? `${sentence(best.why)} ${explanation}` : explanation,
  };
}

const sentence = (text) => `${text[0].toUpperCase()}${text.slice(1)}.`;

function showMoment(recording, frame) {
  const rows = [];
  for (let robot = 0; robot < recording.robots; robot++) {
    const believed = recording.poseOf('pose', frame, robot), found = recording.errors(frame, robot);
    const pose = ([x, y, heading]) => `${x.toFixed(2)}, ${y.toFixed(2)} m, ${degrees(wrapped(heading)).toFixed(1)}\u00b0`;
    const name = recording.robots > 1 ? `Robot ${robot + 1}: ` : '';
    const nees = recording.nees ? recording.nees[frame * recording.robots + robot] : NaN;
    if (recording.hasTruth) rows.push({cells: [`${name}true pose`, pose(recording.poseOf('true', frame, robot))]});
    rows.push({cells: [`${name}believed pose`, pose(believed)]});
    if (recording.hasTruth) {
      rows.push({cells: ['error of position', `${number(100 * found.position_error, 1, ' cm')} (2\u03c3: ${number(200 * found.position, 1, ' cm')})`]});
      rows.push({cells: ['error of heading', `${number(degrees(found.heading_error), 2, '\u00b0')} (2\u03c3: ${number(degrees(2 * found.heading), 2, '\u00b0')})`]});
      rows.push({cells: ['NEES / 3', number(nees, 2)]});
    } else {
      rows.push({cells: ['2\u03c3 of position', number(200 * found.position, 1, ' cm')]});
      rows.push({cells: ['2\u03c3 of heading', number(degrees(2 * found.heading), 2, '\u00b0')]});
    }
  }
  rows.push({cells: ['walls in the map', String(recording.landmarks[frame])]});
  rows.push({cells: ['status', recording.reasonWords(frame)]});
  byId('moment').replaceChildren(table('Pose, error and status', ['quantity', 'now'], rows));
}

function showDecision(recording, frame) {
  const event = recording.latest(frame, ({kind}) => DECISIONS.has(kind));
  const box = byId('decision');
  byId('decision-time').textContent = event ? `at ${event.t.toFixed(1)} s` : '';
  if (box.dataset.index === String(event ? event.index : -1)) return;
  box.dataset.index = String(event ? event.index : -1);
  if (!event) {
    box.replaceChildren(element('p', 'No line has been compared with the map yet.', {class: 'note'}));
    return;
  }
  const {limits} = recording.meta;
  const verdicts = {
    new: `No wall fits, so the line becomes wall ${event.wall}.`, again: `The line is wall ${event.wall}. It corrects pose and map.`,
  };
  const length = Math.hypot(event.ends[2] - event.ends[0], event.ends[3] - event.ends[1]);
  const parts = [
    element('p', verdicts[event.kind] || sentence(event.why), {class: `verdict ${event.kind}`}),
    element('p', `A line of ${event.used} readings, ${length.toFixed(2)} m long${recording.robots > 1 ? `, of robot ${event.robot + 1}` : ''}.`, {class: 'note'}),
  ];
  const rows = event.tests.map((test) => ({
    cells: [String(test.wall), `${test.angle.toFixed(1)}\u00b0`, `${(100 * test.offset).toFixed(1)} cm`, `${(100 * test.gap).toFixed(0)} cm`,
      test.d2 === null ? '\u2013' : test.d2.toFixed(1), test.out ? `out: ${TESTS[test.out]}` : 'fits'],
    mark: test.wall === event.wall ? 'chosen' : test.out ? 'out' : 'fits',
  }));
  const most = {
    cells: ['limit', `${degrees(limits.angle).toFixed(0)}\u00b0`, `${(100 * limits.offset).toFixed(0)} cm`, `${(100 * limits.gap).toFixed(0)} cm`, String(limits.gate), ''],
    mark: 'limit',
  };
  parts.push(rows.length
    ? table('Candidates', ['wall', 'turn', 'offset', 'gap', 'd\u00b2', 'verdict'], [...rows, most])
    : element('p', 'No wall of the map is near.', {class: 'note'}));
  if (event.after) parts.push(correction(event));
  box.replaceChildren(...parts);
}

// The pose and its standard deviations before and after a correction.
function correction({before, after}) {
  const stds = ({cov}) => [100 * Math.sqrt(cov[0]), 100 * Math.sqrt(cov[3]), degrees(Math.sqrt(cov[5]))];
  const [was, is] = [stds(before), stds(after)];
  const moved = after.pose.map((value, i) => (i < 2 ? 100 * (value - before.pose[i]) : degrees(wrapped(value - before.pose[i]))));
  const rows = ['x, cm', 'y, cm', 'heading, deg'].map((name, i) => ({
    cells: [name, `\u00b1${was[i].toFixed(2)}`, `\u00b1${is[i].toFixed(2)}`, `${moved[i] >= 0 ? '+' : ''}${moved[i].toFixed(2)}`],
  }));
  return table('Correction (1\u03c3)', ['of the pose', 'before', 'after', 'moved by'], rows);
}

function showBuffers(recording, frame, colours) {
  const bars = recording.buffersOf(frame).filter(({size}) => size > 0).map(({robot, side, count, fresh, size}) => {
    const words = `${recording.robots > 1 ? `robot ${robot + 1}, ` : ''}${side}: ${fresh} of ${size}${count > fresh ? `, and ${count - fresh} kept` : ''}`;
    const fill = element('span', '', {class: 'fill', style: `width:${Math.min((100 * fresh) / size, 100)}%;background:${colours[side]}`});
    return element('div', [element('span', words, {class: 'words'}), element('span', [fill], {class: 'bar', 'aria-hidden': 'true'})], {class: 'buffer'});
  });
  byId('buffers').replaceChildren(...bars);
}

// Votes of points (mm, in the robot's frame) for lines (r, theta) about the mean of the points.
function votesOf({points, r_step: step}) {
  const count = points.length / 2, bins = 90;
  let mx = 0, my = 0;
  for (let i = 0; i < points.length; i += 2) { mx += points[i] / 1000 / count; my += points[i + 1] / 1000 / count; }
  let farthest = 0;
  for (let i = 0; i < points.length; i += 2) farthest = Math.max(farthest, Math.hypot(points[i] / 1000 - mx, points[i + 1] / 1000 - my));
  const width = Math.max(step, 0.02, (2 * farthest) / 240), half = Math.ceil(farthest / width), rows = 2 * half + 1;
  const votes = new Uint16Array(rows * bins);
  for (let bin = 0; bin < bins; bin++) {
    const theta = ((bin + 0.5) * Math.PI) / bins, cos = Math.cos(theta), sin = Math.sin(theta);
    for (let i = 0; i < points.length; i += 2) {
      const r = (points[i] / 1000 - mx) * cos + (points[i + 1] / 1000 - my) * sin;
      votes[Math.min(Math.max(Math.round(r / width) + half, 0), rows - 1) * bins + bin] += 1;
    }
  }
  return {votes, rows, bins, reach: (half + 0.5) * width, mean: [mx, my]};
}

function showHough(recording, frame, colours, isForced) {
  const event = recording.latest(frame, ({kind}) => kind === 'hough');
  const canvas = byId('hough');
  const key = String(event ? event.index : -1);
  if (!isForced && canvas.dataset.key === key) return;
  canvas.dataset.key = key;
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
  const pen = canvas.getContext('2d');
  pen.scale(ratio, ratio);
  pen.clearRect(0, 0, width, height);
  if (!event) { byId('hough-words').textContent = 'No line has been searched yet.'; return; }
  const {votes, rows, bins, reach, mean} = votesOf(event);
  const most = Math.max(...votes, 1), left = 34, bottom = 20, wide = width - left - 4, high = height - bottom - 6;
  const image = document.createElement('canvas');
  [image.width, image.height] = [bins, rows];
  const small = image.getContext('2d'), pixels = small.createImageData(bins, rows), words = new Uint32Array(pixels.data.buffer);
  const ramp = colours.heat.map((colour) => channels(colour));
  for (let r = 0; r < rows; r++) for (let b = 0; b < bins; b++) {
    words[(rows - 1 - r) * bins + b] = blended(ramp, Math.sqrt(votes[r * bins + b] / most));  // single curves stay visible
  }
  small.putImageData(pixels, 0, 0);
  pen.imageSmoothingEnabled = false;
  pen.drawImage(image, left, 6, wide, high);
  pen.strokeStyle = colours.glow;
  pen.lineWidth = 2;
  for (const [r, theta] of event.lines) {
    const turned = Math.floor(theta / Math.PI), about = r - mean[0] * Math.cos(theta) - mean[1] * Math.sin(theta);
    const x = left + ((theta - turned * Math.PI) / Math.PI) * wide, y = 6 + high * (0.5 - (turned % 2 === 0 ? about : -about) / (2 * reach));
    pen.beginPath();
    pen.arc(Math.min(Math.max(x, left + 8), left + wide - 4), Math.min(Math.max(y, 8), high - 2), 7, 0, 2 * Math.PI);  // all of it is seen
    pen.stroke();
  }
  pen.fillStyle = colours.text;
  pen.font = '11px system-ui, sans-serif';
  pen.textAlign = 'right';
  pen.fillText(`${reach.toFixed(1)} m`, left - 3, 14);
  pen.fillText('r', left - 3, 6 + high / 2);
  pen.fillText(`-${reach.toFixed(1)}`, left - 3, 6 + high);
  pen.textAlign = 'center';
  for (const [share, text] of [[0.02, '0\u00b0'], [0.5, 'direction of the normal'], [0.97, '180\u00b0']]) pen.fillText(text, left + share * wide, height - 5);
  const side = event.side === 'none' ? 'Beams ahead' : `${event.side[0].toUpperCase()}${event.side.slice(1)} buffer`;
  byId('hough-words').textContent = `${recording.robots > 1 ? `Robot ${event.robot + 1}. ` : ''}${side} at ${event.t.toFixed(1)} s: ${event.points.length / 2} points, ` +
    `${event.lines.length === 1 ? '1 line' : `${event.lines.length} lines`} (rings). A line needs ${event.threshold} votes.`;
}

function blended(ramp, share) {
  const place = share * (ramp.length - 1), low = Math.min(Math.floor(place), ramp.length - 2), part = place - low;
  let mixed = 0xff000000;
  for (const shift of [0, 8, 16]) {
    const a = (ramp[low] >> shift) & 255, b = (ramp[low + 1] >> shift) & 255;
    mixed |= Math.round(a + part * (b - a)) << shift;
  }
  return mixed >>> 0;
}

function showFrontiers(recording, frame) {
  const goals = [];
  for (let robot = 0; robot < recording.robots; robot++) {
    const goal = recording.goalOf(frame, robot);
    if (goal) goals.push(goal);
  }
  const found = recording.frontiersOf(frame), heads = ['frontier', 'cells'];
  if (!found.length) {
    const why = recording.meta.frontiers.length ? 'There is no frontier now.' : 'Nothing explores in this recording.';
    byId('frontiers').replaceChildren(element('p', why, {class: 'note'}));
    return;
  }
  const robots = found[0].costs.length;
  for (let robot = 0; robot < robots; robot++) heads.push(robots > 1 ? `cost ${robot + 1}` : 'cost');
  const rows = found.sort((a, b) => (a.costs[0] ?? Infinity) - (b.costs[0] ?? Infinity)).map(({points, x, y, costs}) => {
    const isGoal = goals.some(([gx, gy]) => {
      for (let i = 0; i < points.length; i += 2) if (Math.hypot(points[i] - gx, points[i + 1] - gy) < 0.75 * recording.meta.cell) return true;
      return false;
    });
    const prices = costs.map((cost) => (cost === null ? 'no path' : `${cost.toFixed(1)} m`));
    return {cells: [`${x.toFixed(1)}, ${y.toFixed(1)} m`, String(points.length / 2), ...prices], mark: isGoal ? 'chosen' : ''};
  });
  byId('frontiers').replaceChildren(
    table('The cost is the length of the path, more near walls', heads, rows),
    element('p', 'The robot drives to the frontier of least cost, and keeps a goal while it exists. Small frontiers come last.', {class: 'note'}),
  );
}

function showLoops(recording, frame, seek) {
  const box = byId('loops'), {limits} = recording.meta;
  const loops = recording.events.filter(({kind}) => kind === 'loop');
  const found = loops.map((event) => {
    const why = `d\u00b2 = ${event.d2[0].toFixed(1)} \u2264 ${limits.loop_gate}, offset ${(100 * event.offset[0]).toFixed(1)} cm \u2264 ${(100 * limits.loop_offset).toFixed(0)} cm, ` +
      `overlap at least ${(100 * limits.loop_overlap).toFixed(0)} cm`;
    return {t: event.t, text: `Wall ${event.wall} is wall ${event.other}: ${why}.`};
  });
  for (const {first, second, score, reason} of recording.meta.path_loops || []) {
    const times = [first, second].sort((a, b) => a - b);
    found.push({t: times[1], text: `Smoother: the place at ${times[0].toFixed(1)} s again. Score ${score.toFixed(2)}: ${reason}.`});
  }
  const items = found.sort((a, b) => a.t - b.t).map(({t, text}) => moment(t, text, seek));
  const {key_poses: keys, local_maps: maps} = recording.meta.graph || {key_poses: [], local_maps: []};
  const graph = maps.length ? [element('p', `The smoother divided the path into ${maps.length} local maps of ${keys.length} key poses. The layer Smoothed shows them.`, {class: 'note'})] : [];
  byId('loop-count').textContent = items.length ? String(items.length) : 'none';
  box.replaceChildren(...graph, items.length ? element('ol', items, {class: 'events'}) : element('p', 'No loop was closed.', {class: 'note'}));
}

function moment(seconds, text, seek) {
  const button = element('button', [element('span', `${seconds.toFixed(1)} s`, {class: 'when'}), element('span', text)], {type: 'button'});
  button.addEventListener('click', () => seek(seconds));
  return element('li', [button]);
}

function showReadings(recording, frame) {
  const rows = [], count = recording.meta.beams.length;
  for (let robot = 0; robot < recording.robots; robot++) {
    recording.meta.beams.forEach((beam, index) => {
      const at = (frame * recording.robots + robot) * count + index, range = recording.ranges[at], wall = recording.owner[at];
      const seen = range === 0 ? 'no reading' : range === 65535 ? 'nothing' : `${(range / 1000).toFixed(2)} m`;
      const step = recording.given[at] / recording.meta.stride;
      const when = recording.seconds[Math.min(Math.round(step), recording.frames - 1)];
      const name = `${recording.robots > 1 ? `${robot + 1}: ` : ''}${degrees(beam.angle).toFixed(0)}\u00b0`;
      rows.push({cells: [name, seen, wall ? `wall ${wall} at ${when.toFixed(1)} s` : '\u2013'], mark: wall ? 'fits' : ''});
    });
  }
  byId('readings').replaceChildren(
    table('Each reading is used once, when its wall is known', ['beam', 'range', 'given to'], rows),
  );
}

class EventList {
  constructor(recording, seek) {
    this.seek = seek;
    this.shown = new Set(Object.keys(KINDS).filter((kind) => KINDS[kind].shown));
    this.replace(recording);
  }

  replace(recording) {
    this.recording = recording;
    const present = Object.keys(KINDS).filter((kind) => recording.events.some((event) => event.kind === kind));
    byId('filters').replaceChildren(...present.map((kind) => this.filter(kind)));
    this.fill();
  }

  filter(kind) {
    const count = this.recording.events.filter((event) => event.kind === kind).length;
    const box = element('input', '', {type: 'checkbox', 'data-kind': kind});
    box.checked = this.shown.has(kind);
    box.addEventListener('change', () => {
      if (box.checked) this.shown.add(kind); else this.shown.delete(kind);
      this.fill();
      this.follow(this.frame || 0);
    });
    return element('label', [box, element('span', '', {class: `mark ${KINDS[kind].colour}`}), ` ${KINDS[kind].name} (${count})`]);
  }

  get listed() { return this.recording.events.filter(({kind}) => this.shown.has(kind)); }

  fill() {
    this.items = this.listed;
    byId('event-count').textContent = `${this.items.length} of ${this.recording.events.length}`;
    byId('events').replaceChildren(...this.items.map((event) => {
      const item = moment(event.t, wordsOf(event, this.recording.robots), this.seek);
      item.firstChild.prepend(element('span', '', {class: `mark ${KINDS[event.kind].colour}`}));
      return item;
    }));
    this.current = null;
  }

  // Mark the latest event, and scroll it into the list's view.
  follow(frame) {
    this.frame = frame;
    const now = this.recording.seconds[frame] + 1e-6;
    let at = -1;
    while (at + 1 < this.items.length && this.items[at + 1].t <= now) at += 1;
    if (at === this.current) return;
    const list = byId('events');
    if (this.current !== null && list.children[this.current]) list.children[this.current].firstChild.removeAttribute('aria-current');
    this.current = at;
    const item = list.children[at];
    if (!item || !byId('panel-events').open) return;
    item.firstChild.setAttribute('aria-current', 'true');
    list.scrollTop = item.offsetTop - list.clientHeight / 2;
  }

  // The listed event after (1) or before (-1) a frame.
  beside(frame, way) {
    const now = this.recording.seconds[frame];
    const others = this.items.filter(({t}) => (way > 0 ? t > now + 1e-6 : t < now - 1e-6));
    return others.length ? others[way > 0 ? 0 : others.length - 1] : null;
  }
}
