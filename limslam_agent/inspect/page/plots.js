
// Four plots over time that share their axis, their cursor and the mark of the moment.

class Plots {
  constructor(recording, colours, seek) {
    this.recording = recording;
    this.colours = colours;
    this.seek = seek;
    this.plots = [];
    this.robot = 0;
    this.columns = this.computed();
    this.build();
  }

  // Show the errors of a robot.
  of(robot) {
    this.robot = robot;
    this.columns = this.computed();
    this.build();
  }

  computed() {
    const {recording} = this, count = recording.frames;
    const made = Object.fromEntries(['position', 'position2', 'heading', 'headingUp', 'headingDown', 'nees', 'walls'].map((name) => [name, new Array(count)]));
    const known = (value) => (Number.isFinite(value) ? value : null);
    for (let frame = 0; frame < count; frame++) {
      const found = recording.errors(frame, this.robot), nees = recording.nees ? recording.nees[frame * recording.robots + this.robot] : NaN;
      made.position[frame] = known(100 * found.position_error);
      made.position2[frame] = 200 * found.position;
      made.heading[frame] = known(degrees(found.heading_error));
      made.headingUp[frame] = degrees(2 * found.heading);
      made.headingDown[frame] = -made.headingUp[frame];
      made.nees[frame] = nees > 0 ? Math.max(nees, 0.01) : null;
      made.walls[frame] = recording.landmarks[frame];
    }
    return made;
  }

  build() {
    const {columns, recording} = this, zero = columns.walls.map(() => 0), c = this.colours;
    const band = (colour) => ({stroke: colour, width: 1, dash: [4, 3], points: {show: false}, label: '2\u03c3'});
    const error = (colour) => ({stroke: colour, width: 1.5, points: {show: false}, label: 'error', spanGaps: false});
    const hidden = {stroke: 'transparent', points: {show: false}};
    this.destroy();
    byId('plots').replaceChildren();
    this.add('Error of position, cm', [columns.position2, zero, columns.position], [band(c.robot1), hidden, error(c.wall)], [{series: [1, 2], fill: `${c.robot1}33`}]);
    this.add('Error of heading, deg', [columns.headingUp, columns.headingDown, columns.heading], [band(c.robot1), band(c.robot1), error(c.wall)], [{series: [1, 2], fill: `${c.robot1}33`}]);
    if (recording.nees) {
      this.add('NEES / 3 (1 is right)', [columns.nees, columns.walls.map(() => 1)],
        [{...error(c.wall), label: 'NEES / 3'}, {stroke: c.text, width: 1, dash: [6, 4], points: {show: false}}], [], true);
    }
    this.add('Walls in the map', [columns.walls], [{stroke: c.robot1, width: 1.8, points: {show: false}, paths: uPlot.paths.stepped({align: 1})}]);
    this.resize();  // the first plot was alone in its row when it was drawn
  }

  add(title, data, series, bands = [], isLog = false) {
    const {recording, colours} = this;
    const box = element('figure', [element('figcaption', title)], {class: 'plot'});
    byId('plots').append(box);
    const axis = {stroke: colours.text, grid: {stroke: colours.rule, width: 1}, ticks: {stroke: colours.rule, width: 1}, font: '11px system-ui, sans-serif'};
    const options = {
      width: Math.max(box.clientWidth, 200), height: 150, legend: {show: false},
      cursor: {sync: {key: 'time', setSeries: false}, drag: {x: true, y: false}, points: {show: false}},
      scales: {x: {time: false}, y: isLog ? {distr: 3, log: 10} : {range: (plot, low, high) => padded(low, high)}},
      axes: [{...axis, size: 26, values: (plot, values) => values.map((value) => `${value} s`)}, {...axis, size: 44, ...(isLog ? {splits: decades, values: shortened} : {})}],
      series: [{}, ...series], bands,
      hooks: {
        drawClear: [(plot) => this.statusBand(plot)],
        setScale: [(plot, key) => { if (key === 'x') this.link(plot); }],
        ready: [(plot) => this.clicks(plot)],
      },
    };
    const plot = new uPlot(options, [recording.seconds, ...data], box);
    plot.root.setAttribute('role', 'img');
    plot.root.setAttribute('aria-label', `${title}, over time`);
    plot.now = element('div', '', {class: 'now'});
    plot.over.append(plot.now);
    this.plots.push(plot);
  }

  // Moments at which the status was not ok, as a coloured band.
  statusBand(plot) {
    const {recording, colours} = this, {ctx} = plot, {left, top, width, height} = plot.bbox;
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    for (const {level, from, to} of levelsOf(recording)) {
      if (!level) continue;
      const a = plot.valToPos(from, 'x', true), b = plot.valToPos(to, 'x', true);
      ctx.fillStyle = level === 1 ? `${colours.glow}44` : `${colours.bad}44`;
      ctx.fillRect(a, top, Math.max(b - a, 2), height);
    }
    ctx.restore();
  }

  link(changed) {
    if (this.isLinking) return;
    this.isLinking = true;
    const {min, max} = changed.scales.x;
    for (const plot of this.plots) if (plot !== changed) plot.setScale('x', {min, max});
    this.isLinking = false;
    this.show(this.frame || 0);
  }

  clicks(plot) {
    plot.over.addEventListener('click', (click) => {
      if (plot.select.width > 2) return;
      this.seek(plot.posToVal(click.clientX - plot.over.getBoundingClientRect().left, 'x'));
    });
  }

  show(frame) {
    this.frame = frame;
    for (const plot of this.plots) {
      const at = plot.valToPos(this.recording.seconds[frame], 'x'), isInside = at >= 0 && at <= plot.bbox.width / uPlot.pxRatio;
      plot.now.style.transform = `translateX(${at}px)`;
      plot.now.hidden = !isInside;
    }
  }

  resize() {
    for (const plot of this.plots) {
      const width = plot.root.parentElement.clientWidth;
      if (width && width !== plot.width) plot.setSize({width, height: 150});
    }
    this.show(this.frame || 0);
  }

  destroy() {
    for (const plot of this.plots) plot.destroy();
    this.plots = [];
  }
}

// 1,000,000 has no room beside a plot; 1M has.
function shortened(plot, values) {
  const short = new Intl.NumberFormat('en', {notation: 'compact'});
  return values.map((value) => (value === null ? '' : short.format(value)));
}

// Powers of ten within the range of a logarithmic axis.
function decades(plot, axis, low, high) {
  const found = [];
  for (let power = Math.ceil(Math.log10(low) - 1e-9); power <= Math.log10(high) + 1e-9; power++) found.push(10 ** power);
  return found;
}

function padded(low, high) {
  if (low === null || high === null) return [0, 1];
  const margin = 0.06 * Math.max(high - low, 1e-3);
  return [low === 0 ? 0 : low - margin, high + margin];
}

// The stretches of equal status: level, and begin and end, s.
function levelsOf(recording) {
  if (recording.levelStretches) return recording.levelStretches;
  const found = [];
  for (let frame = 0; frame < recording.frames; frame++) {
    const level = recording.level(frame), last = found[found.length - 1];
    if (last && last.level === level) last.to = recording.seconds[Math.min(frame + 1, recording.frames - 1)];
    else found.push({level, from: recording.seconds[frame], to: recording.seconds[Math.min(frame + 1, recording.frames - 1)]});
  }
  recording.levelStretches = found;
  return found;
}
