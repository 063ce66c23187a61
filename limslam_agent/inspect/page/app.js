
// The player: it holds the moment, and tells pictures, panels and plots about it.

const NAMED_COLOURS = [
  'paper', 'unknown', 'free', 'occupied', 'ink', 'text', 'faint', 'rule', 'wall', 'wallInk', 'frontier', 'frontierInk', 'glow', 'good', 'bad',
  'plan', 'left', 'right', 'ahead', 'beam', 'ghost', 'smoothed', ...ROBOT_NAMES, 'heat0', 'heat1', 'heat2', 'heat3',
];

function readColours() {
  const style = getComputedStyle(document.documentElement);
  const colours = Object.fromEntries(NAMED_COLOURS.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  colours.heat = [0, 1, 2, 3].map((place) => colours[`heat${place}`]);
  return colours;
}

const ICONS = {
  first: 'M3 3h2v10H3zM13 3v10L6 8z', previous: 'M8 3v10L2 8zM14 3v10L8 8z', back: 'M11 3v10L4 8z', play: 'M4 2v12l10-6z',
  pause: 'M4 3h3v10H4zM9 3h3v10H9z', forward: 'M5 3v10l7-5z', next: 'M2 3v10l6-5zM8 3v10l6-5z', last: 'M11 3h2v10h-2zM3 3v10l7-5z',
};

class Player {
  constructor(recording) {
    this.recording = recording;
    this.frame = 0;
    this.time = 0;
    this.speed = 5;
    this.isPlaying = false;
    this.colours = readColours();
    this.scene = new Scene(recording, {truth: byId('truth'), belief: byId('belief')}, this.colours);
    const seek = (seconds) => this.seek(seconds);
    this.list = new EventList(recording, seek);
    this.plots = new Plots(recording, this.colours, seek);
    this.prepare();
    this.connect();
    this.readHash();
    this.show(true);
  }

  // Go on with a longer recording of the same run. Whoever looks at the newest moment stays there.
  replace(recording) {
    const isNewest = this.frame >= this.recording.frames - 1 && !this.isPlaying, {time} = this;
    const isWhole = this.scene.zoom === 1 && !this.scene.follows;
    this.recording = this.scene.recording = this.plots.recording = recording;
    this.scene.bounds = boundsOf(recording);
    if (isWhole) this.scene.fit();
    this.shape();
    this.list.replace(recording);
    this.frame = isNewest ? recording.frames - 1 : recording.frameAt(time);
    this.time = recording.seconds[this.frame];
    this.plots.of(this.plots.robot);
    this.show(true);
  }

  // What depends on the length and the extent of the recording.
  shape() {
    const {recording} = this, [x0, y0, x1, y1] = this.scene.bounds;
    byId('slider').max = recording.frames - 1;
    byId('views').style.setProperty('--aspect', Math.min(Math.max((x1 - x0) / (y1 - y0), 0.75), 1.9));
  }

  prepare() {
    const {recording} = this;
    this.shape();
    byId('check').textContent = recording.meta.check;
    if (!recording.hasTruth && !recording.edges) {
      byId('truth-figure').remove();
      document.querySelector('.switch').remove();
      this.scene.canvases.truth = document.createElement('canvas');
      this.scene.measure();
      byId('views').classList.add('alone');
    }
    const robots = Array.from({length: recording.robots}, (_, robot) => element('option', String(robot + 1), {value: robot}));
    byId('robot').replaceChildren(...robots);
    byId('whose').hidden = recording.robots === 1;
    byId('stages').replaceChildren(...STAGES.map((name) => element('li', name)));
    const layers = Object.entries(LAYERS).filter(([name]) => this.hasLayer(name)).map(([name, [words, shown]]) => {
      const box = element('input', '', {type: 'checkbox', 'data-layer': name});
      box.checked = shown;
      box.addEventListener('change', () => { this.scene.on[name] = box.checked; this.show(); });
      return element('label', [box, ` ${words}`]);
    });
    byId('layers').replaceChildren(...layers);
    for (const [id, path] of Object.entries(ICONS)) if (byId(id)) this.draw(id, path);
    this.legend();
  }

  draw(id, path) { byId(id).querySelector('path').setAttribute('d', path); }

  hasLayer(name) {
    const {recording} = this;
    const needs = {over: recording.edges, smoothed: recording.smoothed || recording.final_walls, frontiers: recording.meta.frontiers.length, plan: recording.plans.length};
    return !(name in needs) || Boolean(needs[name]);
  }

  legend() {
    const entries = [
      ['wall', 'a wall of the map; its pale band holds it with 2 sigma'], ['robot1', 'the robot: the ellipse and the sector hold its pose with 95 %'],
      ['left', 'points of the left buffer'], ['right', 'points of the right buffer'], ['ahead', 'points of the beams ahead'],
      ['frontier', 'frontier: free cells beside unknown ones, with the cost of the path'], ['plan', 'the plan and its goal'],
      ['good', 'a line that has just corrected the map'], ['glow', 'a line that waits, and the walls that an event is about'],
      ['occupied', 'occupied cells'], ['free', 'free cells'], ['unknown', 'unknown cells'],
    ];
    byId('legend').replaceChildren(...entries.map(([colour, words]) => element('li', [element('span', '', {class: `mark ${colour}`}), ` ${words}`])));
  }

  connect() {
    const on = (id, action) => byId(id).addEventListener('click', action);
    on('play', () => this.toggle());
    on('first', () => this.stopAt(0));
    on('last', () => this.stopAt(this.recording.frames - 1));
    on('back', () => this.stopAt(this.frame - 1));
    on('forward', () => this.stopAt(this.frame + 1));
    on('previous', () => this.jump(-1));
    on('next', () => this.jump(1));
    on('zoom-in', () => this.zoomBy(1.4));
    on('zoom-out', () => this.zoomBy(1 / 1.4));
    on('fit', () => { this.follow(false); this.scene.fit(); this.show(); });
    on('follow', () => this.follow(!this.scene.follows));
    on('theme', () => this.setTheme(document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark'));
    on('help', () => byId('help-dialog').showModal());
    on('link', () => this.copyLink());
    for (const name of ['truth', 'belief']) if (byId(`show-${name}`)) on(`show-${name}`, () => this.showPicture(name));
    byId('slider').addEventListener('input', () => this.stopAt(Number(byId('slider').value)));
    byId('speed').addEventListener('change', () => { this.speed = Number(byId('speed').value); });
    byId('robot').addEventListener('change', () => this.plots.of(Number(byId('robot').value)));
    document.addEventListener('keydown', (press) => this.onKey(press));
    window.addEventListener('hashchange', () => this.readHash());
    window.addEventListener('resize', () => { this.plots.resize(); this.show(true); });
    systemIsDark.addEventListener('change', () => { applyTheme(); this.recolour(); });
    for (const panel of document.querySelectorAll('.panels details')) panel.addEventListener('toggle', () => this.show(true));
    for (const canvas of Object.values(this.scene.canvases)) this.movable(canvas);
  }

  onKey(press) {
    if (press.ctrlKey || press.metaKey || press.altKey || byId('help-dialog').open) return;
    const {tagName, type} = press.target, isSlider = tagName === 'INPUT' && type === 'range';
    if (tagName === 'SELECT' || (press.key === ' ' && !isSlider && ['BUTTON', 'INPUT', 'SUMMARY', 'A'].includes(tagName))) return;
    if (press.target === byId('events') && press.key.startsWith('Arrow')) return;
    const {frames, duration} = this.recording, second = Math.max(1, Math.round((frames - 1) / Math.max(duration, 1e-3)));
    const step = press.shiftKey ? second : 1;
    const actions = {
      ' ': () => this.toggle(), ArrowLeft: () => this.stopAt(this.frame - step), ArrowRight: () => this.stopAt(this.frame + step),
      PageUp: () => this.jump(-1), PageDown: () => this.jump(1), Home: () => this.stopAt(0), End: () => this.stopAt(this.recording.frames - 1),
      '+': () => this.zoomBy(1.4), '=': () => this.zoomBy(1.4), '-': () => this.zoomBy(1 / 1.4), f: () => byId('fit').click(),
      r: () => byId('follow').click(), l: () => this.copyLink(), d: () => byId('theme').click(), '?': () => byId('help').click(),
    };
    if (isSlider) Object.assign(actions, {ArrowUp: actions.ArrowRight, ArrowDown: actions.ArrowLeft});
    if (!(press.key in actions)) return;
    press.preventDefault();
    actions[press.key]();
  }

  // Drag to move, wheel or pinch to zoom.
  movable(canvas) {
    const pointers = new Map();
    canvas.addEventListener('pointerdown', (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    });
    canvas.addEventListener('pointermove', (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const scale = this.scene.scaleOf(canvas), now = [event.offsetX, event.offsetY];
      if (pointers.size === 1) {
        this.follow(false);
        this.scene.centre[0] -= (now[0] - before[0]) / scale;
        this.scene.centre[1] += (now[1] - before[1]) / scale;
      } else {
        const [, other] = [...pointers].find(([id]) => id !== event.pointerId);
        const apart = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]);
        this.scene.zoomBy(apart(now) / Math.max(apart(before), 1), this.scene.toWorld(canvas, ...other));
      }
      pointers.set(event.pointerId, now);
      this.show();
    });
    for (const name of ['pointerup', 'pointercancel']) canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
    canvas.addEventListener('wheel', (event) => {
      event.preventDefault();
      this.zoomBy(Math.exp(-0.0015 * event.deltaY), this.scene.toWorld(canvas, event.offsetX, event.offsetY));
    }, {passive: false});
  }

  zoomBy(factor, about) { this.scene.zoomBy(factor, about); this.show(); }

  follow(isWanted) {
    if (isWanted && this.scene.zoom < 2) this.scene.zoom = 2.5;
    this.scene.follows = isWanted;
    byId('follow').setAttribute('aria-pressed', String(isWanted));
    this.show();
  }

  showPicture(name) {
    byId('views').dataset.shown = name;
    for (const each of ['truth', 'belief']) byId(`show-${each}`).setAttribute('aria-pressed', String(each === name));
    this.show(true);
  }

  setTheme(theme) {
    applyTheme(theme);
    try { localStorage.setItem('limslam-theme', theme); } catch { /* a file may not store anything */ }
    this.recolour();
  }

  recolour() {
    this.colours = readColours();
    this.scene.colours = this.plots.colours = this.colours;
    const isDark = getComputedStyle(document.documentElement).colorScheme === 'dark';
    byId('theme').setAttribute('aria-pressed', String(isDark));
    this.plots.build();
    this.show(true);
  }

  async copyLink() {
    this.writeHash();
    try { await navigator.clipboard.writeText(location.href); } catch { /* the address bar has the link, too */ }
    byId('link').textContent = 'Copied';
    setTimeout(() => { byId('link').textContent = 'Copy link'; }, 1500);
  }

  readHash() {
    const found = /[#&]t=(\d+(?:\.\d*)?)/.exec(location.hash);
    if (!found || Math.abs(Number(found[1]) - this.recording.seconds[this.frame]) < 0.05) return false;
    this.seek(Number(found[1]));
    return true;
  }

  writeHash() { history.replaceState(null, '', `#t=${this.recording.seconds[this.frame].toFixed(1)}`); }

  toggle() {
    if (this.isPlaying) { this.pause(); return; }
    if (this.frame >= this.recording.frames - 1) this.goTo(0);
    this.isPlaying = true;
    this.buttonOfPlay();
    let before = performance.now();
    const tick = (now) => {
      if (!this.isPlaying) return;
      this.time += ((now - before) / 1000) * this.speed;
      before = now;
      const frame = this.recording.frameAt(this.time);
      if (frame !== this.frame) { this.frame = frame; this.show(); }
      if (frame >= this.recording.frames - 1) this.pause(); else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  pause() {
    this.isPlaying = false;
    this.buttonOfPlay();
    this.writeHash();
    this.show(true);
  }

  buttonOfPlay() {
    const button = byId('play');
    this.draw('play', this.isPlaying ? ICONS.pause : ICONS.play);
    button.setAttribute('aria-label', this.isPlaying ? 'Pause' : 'Play');
    byId('caption').setAttribute('aria-live', this.isPlaying ? 'off' : 'polite');
  }

  seek(seconds) { this.stopAt(this.recording.frameAt(Math.min(Math.max(seconds, 0), this.recording.duration))); }

  stopAt(frame) {
    this.isPlaying = false;
    this.buttonOfPlay();
    this.goTo(frame);
    this.writeHash();
  }

  jump(way) {
    const event = this.list.beside(this.frame, way);
    if (event) this.seek(event.t + 1e-3);
    else this.stopAt(way > 0 ? this.recording.frames - 1 : 0);
  }

  goTo(frame) {
    this.frame = Math.min(Math.max(frame, 0), this.recording.frames - 1);
    this.time = this.recording.seconds[this.frame];
    this.show();
  }

  show(isForced = false) {
    const {recording, frame} = this, seconds = recording.seconds[frame];
    if (isForced) this.scene.measure();
    this.scene.draw(frame);
    this.plots.show(frame);
    byId('slider').value = frame;
    byId('slider').setAttribute('aria-valuetext', `${seconds.toFixed(1)} s`);
    byId('clock').textContent = `${seconds.toFixed(1)} s`;
    this.showCaption();
    if (byId('panel-moment').open) showMoment(recording, frame);
    if (byId('panel-decision').open) showDecision(recording, frame);
    if (byId('panel-hough').open) { showBuffers(recording, frame, this.colours); showHough(recording, frame, this.colours, isForced); }
    if (byId('panel-frontiers').open) showFrontiers(recording, frame);
    if (byId('panel-readings').open) showReadings(recording, frame);
    this.list.follow(frame);
    if (isForced || !this.hasLoops) { showLoops(recording, frame, (time) => this.seek(time)); this.hasLoops = true; this.drawTicks(); }
  }

  showCaption() {
    const {recording, frame} = this, level = recording.level(frame);
    const caption = captionOf(recording, frame, this.isPlaying ? Math.max(1.0, 0.5 * this.speed) : 0.25);
    byId('headline').textContent = caption.headline;
    byId('explanation').textContent = caption.explanation;
    [...byId('stages').children].forEach((item, place) => {
      if (caption.stages.includes(place)) item.setAttribute('aria-current', 'step'); else item.removeAttribute('aria-current');
    });
    byId('status').dataset.level = level;
    byId('status-words').textContent = recording.reasonWords(frame);
  }

  // The status as a band, and the listed events as marks, above the slider.
  drawTicks() {
    const canvas = byId('ticks'), ratio = window.devicePixelRatio || 1, {recording, colours} = this;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    [canvas.width, canvas.height] = [width * ratio, height * ratio];
    const pen = canvas.getContext('2d');
    pen.scale(ratio, ratio);
    const inset = 8, place = (seconds) => inset + ((width - 2 * inset) * recording.frameAt(seconds)) / Math.max(recording.frames - 1, 1);
    for (const {level, from, to} of levelsOf(recording)) {
      pen.fillStyle = [colours.good, colours.glow, colours.bad][level];
      pen.globalAlpha = level ? 1 : 0.5;
      pen.fillRect(place(from), height - 4, Math.max(place(to) - place(from), 1.5), 4);
    }
    pen.globalAlpha = 1;
    for (const event of this.list.items) {
      pen.fillStyle = colours[KINDS[event.kind].colour];
      pen.fillRect(place(event.t) - 0.75, 1, 1.5, height - 7);
    }
  }
}

const systemIsDark = window.matchMedia('(prefers-color-scheme: dark)');
let chosenTheme = null;

// The theme that the reader has chosen, or that of the system.
function applyTheme(chosen = chosenTheme) {
  chosenTheme = chosen;
  document.documentElement.dataset.theme = chosen || (systemIsDark.matches ? 'dark' : 'light');
}

async function start() {
  let stored = null;
  try { stored = localStorage.getItem('limslam-theme'); } catch { /* a file may not read anything */ }
  applyTheme(stored);
  if (!('DecompressionStream' in window)) throw new Error('This browser is too old: it cannot decompress the recording.');
  const written = byId('data').textContent.trim(), isLive = !written;
  const {number, text} = isLive ? await firstState() : {number: 0, text: written};
  const recording = await unpack(text);
  byId('loading').remove();
  document.body.dataset.state = 'shown';
  window.player = new Player(recording);
  window.player.recolour();
  document.body.dataset.state = 'ready';
  document.body.dataset.loaded = String(Math.round(performance.now()));
  if (isLive) watch(window.player, number);
}

// The next state of a run that goes on now: its number, whether it is the last one, and its text, which is empty if
// none has come for a while.
async function nextState(known) {
  const answer = await fetch(`/recording?${known}`);
  const [number, isOver, orders] = ['X-State', 'X-Over', 'X-Orders'].map((name) => JSON.parse(answer.headers.get(name)));
  return {number, isOver: isOver === 1, orders, text: await answer.text()};
}

// The first state, which may not have come yet.
async function firstState() {
  for (;;) {
    const state = await nextState(0);
    if (state.text) return state;
    byId('loading').textContent = 'Waiting for the first step of the run ...';
  }
}

// Follow a run: each new state has everything until then.
async function watch(player, first) {
  const say = (words) => { byId('check').textContent = words; };
  say('The run goes on now. Stay at the end to follow it.');
  player.stopAt(player.recording.frames - 1);
  const token = new URLSearchParams(location.search).get('token');
  const orders = token && new Orders(player, token);
  let known = first, isOver = false;
  try {
    while (!isOver) {
      const state = await nextState(known);
      if (state.text) player.replace(await unpack(state.text));
      if (orders && state.orders) orders.show(state.orders);
      ({number: known, isOver} = state);
    }
    say('The run is over.');
  } catch {
    say('The run is over, or the connection is lost.');
  }
  if (orders) orders.end();
  document.body.dataset.state = 'over';
}

start().catch((error) => {
  const box = byId('loading') || byId('headline');
  box.textContent = `The recording cannot be shown: ${error.message}`;
  document.body.dataset.state = 'failed';
  throw error;
});
