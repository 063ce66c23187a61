// The leaderboard: tables that can be sorted, and the share of plans that each entry has solved over time.

const board = JSON.parse(document.getElementById('data').textContent);
const byId = (id) => document.getElementById(id);
const COLOURS = ['#2667b2', '#c4530f', '#288c5c', '#8454aa', '#a88a00', '#14808e', '#a83e6e', '#6b7280'];
const DASHES = [[], [8, 4], [2, 3], [10, 3, 2, 3]];

function element(name, children = [], attributes = {}) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...[].concat(children));
  return made;
}

const MEANINGS = {
  '95 % after, s': 'Mean simulated time until 95 % of the floor is covered, with its 95 % interval. A lost plan counts as the longest time.',
  '80 % after, s': 'The same for 80 %.',
  Solved: 'Plans whose floor was covered to 95 %, with at least 95 % of the map correct at the end.',
  'False claims': 'Plans whose robots said that they were done and were not.',
  'Correct coverage': 'Share of the floor that was covered and is correct in the map, 0 to 1.',
  'F1 at 5 cm': 'Agreement of the walls with the true ones within 5 cm, 0 to 1.',
  Touches: 'Contacts begun, of all robots.',
  'ATE, m': 'Mean error of the position over the path.',
  'NEES/3': 'Error of the pose against the error that the robot itself states. About 1 is right; more is too sure.',
  'CPU, s': 'Time of the processor for a plan, with simulator and scores.',
  Failed: 'Plans that ended with an error.',
  'Acts on': 'What the entry gets: readings, or the belief of the shipped map.',
};

const number = (value, digits) => (value === null || value === undefined ? '-' : Number(value).toFixed(digits));
const counted = (count, noun) => `${count} ${noun}${count === 1 ? '' : 's'}`;
const interval = (mean, digits) => number(mean.value, digits) + (mean.low === null ? '' : ` [${number(mean.low, digits)}, ${number(mean.high, digits)}]`);

// A table whose headings sort it. A column has a title, a value to sort by, and a cell (text or element).
function fill(table, columns, rows, {sorted = null, rowClass = () => ''} = {}) {
  const state = {column: sorted, up: true};
  const heads = columns.map((column, index) => {
    const button = element('button', column.title, {type: 'button', title: MEANINGS[column.title] || column.title});
    button.addEventListener('click', () => {
      state.up = state.column === index ? !state.up : true;
      state.column = index;
      draw();
    });
    return element('th', button, {scope: 'col', class: column.text || ''});
  });
  const body = element('tbody');
  table.replaceChildren(element('thead', element('tr', heads)), body);
  const isMissing = (value) => value === null || value === undefined || value === '';
  const order = (first, second) => {
    const [a, b] = [first, second].map(columns[state.column].value);
    if (isMissing(a) || isMissing(b)) return isMissing(a) - isMissing(b);  // what has no value comes last
    return (state.up ? 1 : -1) * (a < b ? -1 : a > b ? 1 : 0);
  };
  function draw() {
    heads.forEach((head, index) => head.setAttribute('aria-sort', index !== state.column ? 'none' : state.up ? 'ascending' : 'descending'));
    const listed = state.column === null ? rows : [...rows].sort(order);
    body.replaceChildren(...listed.map((row) => element('tr', columns.map((column) => element('td', column.cell(row), {class: column.text || ''})), {class: rowClass(row)})));
  }
  draw();
}

// text: the class of a column of words, 'text', or 'text wide' where its lines may break.
const column = (title, value, cell, text = '') => ({title, value, cell, text});
const plain = (title, value, digits) => column(title, value, (row) => number(value(row), digits));

function entryColumns() {
  const name = column('Entry', (row) => row.name, (row) => {
    const button = element('button', row.name, {type: 'button'});
    button.addEventListener('click', () => show(row));
    return button;
  }, 'text wide');
  const common = [
    plain('ATE, m', (row) => row.figures.ate_final_m, 3), plain('NEES/3', (row) => row.figures.anees_final, 2),
    plain('CPU, s', (row) => row.figures.cpu_s, 1), plain('Failed', (row) => row.failed, 0),
    column('Acts on', (row) => row.uses, (row) => row.uses, 'text'),
    column('By', (row) => row.authors.join(', '), (row) => row.authors.join(', '), 'text wide'),
  ];
  const place = column('Place', (row) => row.place, (row) => row.place);
  const score = column('95 % after, s', (row) => row.score.value, (row) => interval(row.score, 1));
  return [
    place, name, score, plain('80 % after, s', (row) => row.figures.plan_time_to_80_s, 1),
    plain('Solved', (row) => row.solved, 0), plain('False claims', (row) => row.claimed, 0),
    plain('Correct coverage', (row) => row.figures.correct_coverage, 3),
    plain('F1 at 5 cm', (row) => row.figures.wall_f1_5cm, 3), plain('Touches', (row) => row.figures.touches, 2), ...common,
  ];
}

function runColumns() {
  const result = column('Result', (row) => row.lost, (row) => (row.lost ? element('span', `lost: ${row.lost}`, {class: 'lost'}) : 'explored'), 'text wide');
  const look = column('Inspector', (row) => row.link || row.folder, (row) => {
    if (row.link) return element('a', 'open', {href: row.link});
    return row.folder ? element('code', `limslam inspect ${row.folder}`) : '-';
  }, 'text wide');
  return [
    plain('Plan', (row) => row.plan, 0), column('World', (row) => row.world, (row) => row.world, 'text'),
    plain('Noise, m', (row) => row.noise, 2), plain('Robots', (row) => row.robots, 0),
    column('Fault', (row) => row.fault, (row) => row.fault, 'text'), result,
    ...board.shown.map(([name, title, digits]) => plain(title, (row) => row[name], digits)), look,
  ];
}

let chosen = null;
function show(entry) {
  chosen = entry;
  byId('runs-title').textContent = `Runs of ${entry.name}`;
  byId('about').textContent = `${entry.about ? `${entry.about} ` : ''}Map: ${entry.preset}. Version ${entry.version}, commit ${entry.commit.slice(0, 12)}, files ${entry.digest}.`;
  fill(byId('runs'), runColumns(), entry.rows);
  fill(byId('entries'), entryColumns(), board.entries, {rowClass: (row) => (row === chosen ? 'chosen' : '')});
}

// The share of plans that were solved by each time.
function curves() {
  const count = 121;
  const axis = Array.from({length: count}, (_, index) => (index * board.longest) / (count - 1));
  const share = (entry) => axis.map((value) => {
    const passed = entry.values.filter((each, index) => each <= value && !entry.rows[index].lost);
    return passed.length / entry.values.length;
  });
  return [axis, ...board.entries.map(share)];
}

const colour = (index) => COLOURS[index % COLOURS.length];
const dash = (index) => DASHES[Math.floor(index / COLOURS.length) % DASHES.length];
let plot = null;
function draw() {
  const style = getComputedStyle(document.documentElement), get = (name) => style.getPropertyValue(name).trim();
  const axis = {stroke: get('--text'), grid: {stroke: get('--rule'), width: 1}, ticks: {stroke: get('--rule'), width: 1}, font: '12px system-ui, sans-serif'};
  if (plot) plot.destroy();
  const options = {
    width: Math.max(byId('plot').clientWidth, 240), height: 300, legend: {show: false}, cursor: {show: false},
    scales: {x: {time: false}, y: {range: [0, 1.02]}},
    axes: [{...axis, label: 'Simulated time, s', labelSize: 22}, {...axis, size: 60, values: (_, values) => values.map((value) => `${Math.round(100 * value)} %`)}],
    series: [{}, ...board.entries.map((entry, index) => ({label: entry.name, stroke: colour(index), dash: dash(index), width: 2, points: {show: false}}))],
  };
  plot = new uPlot(options, curves(), byId('plot'));
  plot.root.setAttribute('role', 'img');
  plot.root.setAttribute('aria-label', byId('plot-title').textContent);
}

function begin() {
  const order = 'mean time to 95 % coverage, where a lost plan counts as the longest time (less is better)';
  byId('summary').textContent = `${counted(board.plans.length, 'plan')}${board.secret ? ' from a secret seed' : ''}, the same for all entries. Order: ${order}.${board.entries.some((entry) => entry.score.low !== null) ? ' Intervals are 95 % bootstrap intervals of the mean.' : ''}`;
  byId('meanings').replaceChildren(...Object.entries(MEANINGS).flatMap(([title, words]) => [element('dt', title), element('dd', words)]));
  byId('pairs-section').hidden = !board.comparisons.length;
  byId('plot-title').textContent = 'Share of plans solved over time';
  byId('plot-hint').textContent = 'A plan is solved at the time of 95 % true coverage, if at least 95 % are correct at the end. A curve that is further to the upper left is better.';
  byId('legend').replaceChildren(...board.entries.map((entry, index) => element('li', [element('span', [], {style: `border-color: ${colour(index)}; border-top-style: ${dash(index).length ? 'dashed' : 'solid'}`}), entry.name])));
  byId('pairs-hint').textContent = `Entries on the same plans: the time of the second minus that of the first, and the p-value of Wilcoxon's signed-rank test, corrected for the number of pairs (Holm).`;
  fill(byId('pairs'), [
    column('First', (row) => row.first, (row) => row.first, 'text wide'), column('Second', (row) => row.second, (row) => row.second, 'text wide'),
    column('Mean difference', (row) => row.difference.value, (row) => interval(row.difference, 1)),
    column('p', (row) => row.p, (row) => (row.p === null ? '-' : row.p < 0.001 ? '< 0.001' : row.p.toFixed(3))), plain('Plans', (row) => row.plans, 0),
  ], board.comparisons);
  show(board.entries[0]);
  draw();
  let width = innerWidth;
  addEventListener('resize', () => { if (innerWidth !== width) { width = innerWidth; draw(); } });
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', draw);
  document.body.dataset.state = 'ready';
}

begin();
