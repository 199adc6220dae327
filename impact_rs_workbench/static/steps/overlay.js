// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Overlay: runs, models and estimates over each other; the user chooses, filters and pins.

import {colourOf, draw, drawOverlay, floats, LEGEND_BELOW, plotPlace} from '../figures.js';
import {Tabbed} from '../navigation.js';
import {folderOf, tracksOf} from '../results.js';
import {
  ask, button, count, fill, h, labelled, LatestRequest, mistake, note, number, plain, query, state, table, withUnit,
} from '../tools.js';

/** @typedef {import('../types.d.ts').Step} Step */
// Entries with a larger `last` are chosen later.
/** @typedef {{key: string, text: string, stamp?: number, last?: number}} Entry */

const FIRST = 3; // entries that are chosen at first
const MOST = 60; // rows of the list
const MOST_CHOSEN = 30; // entries over each other: more curves are one blot
const INK = '#000000', NAMED = '#009E73', NOT_NAMED = '#777777';

// ---- choices, which the server keeps ------------------------------------------------------------------------------

let savedChoices = null; // what was chosen before, asked for once

/**
 * Keeps the newest value of one list: posts go one after the other, so that none overtakes a later one. A value that
 * still waits when the page is left is posted at once; `keepalive` lets a post outlive the page.
 */
class Keeper {
  constructor() {
    /** @type {any} the newest value, while an earlier one is on its way */
    this.waiting = null;
    this.busy = false;
    addEventListener('pagehide', () => {
      if (this.waiting) this.post();
    });
  }

  post() {
    const body = this.waiting;
    this.waiting = null;
    return ask('/api/choices', body, {keepalive: true}).catch(() => {}); // the page shows it all the same
  }

  async keep(value) {
    this.waiting = value;
    if (this.busy) return;
    this.busy = true;
    while (this.waiting) await this.post();
    this.busy = false;
  }
}

/** A list to choose from, with a filter and pins: pinned entries stay on top and chosen. */
class Choice {
  /** @param {'runs' | 'models'} name @param {() => void} drawn called when the choice has changed */
  constructor(name, drawn) {
    this.name = name;
    this.drawn = drawn;
    /** @type {Entry[]} */
    this.all = [];
    /** @type {Set<string>} */
    this.chosen = new Set();
    /** @type {Set<string>} */
    this.pinned = new Set();
    this.touched = false; // by the user, now or earlier
    this.keeper = new Keeper();
    this.filter = h('input', {type: 'search', id: `overlay-${name}-filter`, placeholder: 'all',
      oninput: () => this.show()});
    this.list = h('ul', {class: 'runs', id: `overlay-${name}-list`});
    const act = (text, change) => button(text, () => { change(); this.show(); this.changed(); });
    this.node = h('div', {}, labelled('filter', this.filter), h('div', {class: 'actions'},
      act('Choose all below', () => this.fitting().slice(0, MOST_CHOSEN).forEach(({key}) => this.chosen.add(key))),
      act('Choose none', () => { this.chosen = new Set(this.pinned); })), this.list);
  }

  // The user has changed the choice.
  changed() {
    this.touched = true;
    this.drawn();
    this.keeper.keep({name: this.name, chosen: [...this.chosen], pinned: [...this.pinned]});
  }

  /** @param {Entry[]} all */
  async offer(all) {
    if (JSON.stringify(all) === JSON.stringify(this.all)) return;
    this.all = all;
    savedChoices ??= ask('/api/choices').catch(() => ({}));
    const saved = (await savedChoices)[this.name];
    if (this.all !== all) return; // there are others meanwhile
    if (saved && !this.touched) {
      this.touched = true;
      this.chosen = new Set(saved.chosen);
      this.pinned = new Set(saved.pinned);
    }
    for (const set of [this.chosen, this.pinned]) {
      for (const key of set) if (!all.some((entry) => entry.key === key)) set.delete(key);
    }
    const first = [...all].sort((a, b) => (a.last ?? 0) - (b.last ?? 0));
    if (!this.touched && !this.chosen.size) for (const {key} of first.slice(0, FIRST)) this.chosen.add(key);
    this.show();
    this.drawn();
  }

  // In the order of the list, the pinned ones first.
  selected() {
    const chosen = this.all.filter(({key}) => this.chosen.has(key)), pinned = ({key}) => this.pinned.has(key);
    return [...chosen.filter(pinned), ...chosen.filter((entry) => !pinned(entry))];
  }

  // Entries that contain every word of the filter.
  fitting() {
    const words = this.filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    return this.all.filter((entry) => words.every((word) => entry.text.toLowerCase().includes(word)));
  }

  /** @param {Entry} entry */
  row({key, text}) {
    const pinned = this.pinned.has(key);
    const tick = h('input', {type: 'checkbox', onchange: () => {
      if (tick.checked) this.chosen.add(key); else this.chosen.delete(key);
      this.changed();
    }});
    tick.checked = this.chosen.has(key);
    const pin = () => {
      if (pinned) this.pinned.delete(key); else { this.pinned.add(key); this.chosen.add(key); }
      this.show();
      this.changed();
    };
    return h('li', {'data-key': key}, h('label', {}, tick, text), button(pinned ? '★' : '☆', pin,
      {'aria-pressed': String(pinned), 'aria-label': `pin ${text}`, title: 'pin'}));
  }

  show() {
    const pinned = (entry) => this.pinned.has(entry.key);
    const shown = [...this.all.filter(pinned), ...this.fitting().filter((entry) => !pinned(entry))];
    const quiet = (text) => h('li', {class: 'quiet'}, text);
    this.list.replaceChildren(...shown.slice(0, MOST).map((entry) => this.row(entry)),
      ...(shown.length > MOST ? [quiet(`${shown.length - MOST} more: type into the filter`)] : []),
      ...(shown.length ? [] : [quiet('none')]));
  }

  /** The line of a curve. @param {number} index @param {Entry} entry */
  lineOf(index, {key}) { return {color: colourOf(index), width: this.pinned.has(key) ? 3 : 1.5}; }
}

/** Answers by key; a failed question is asked again. @extends {Map<string, Promise<any>>} */
class Known extends Map {
  /** @param {string} key @param {() => Promise<any>} make */
  of(key, make) {
    if (!this.has(key)) {
      this.set(key, make());
      this.get(key).catch(() => this.delete(key));
    }
    return this.get(key);
  }
}

// ---- recorded trials ----------------------------------------------------------------------------------------------

// Values of a Plotly trace along x: an array, packed numbers, or even steps.
function curveOf(trace) {
  const unpacked = (values) => values?.bdata ? floats(values.bdata) : values;
  const y = unpacked(trace.y), x = unpacked(trace.x);
  return {y, x: x ?? Array.from(y, (_, index) => trace.x0 + index * trace.dx)};
}

// Curves of a trial by figure and trace.
const curvesOf = ({plots}) => Object.fromEntries(plots.flatMap(({title, figure: {data, layout}}) =>
  data.filter((trace) => trace.name).map((trace) =>
    [`${title}, ${trace.name}`, {...curveOf(trace), axis: layout.yaxis.title.text}])));

/** Recorded trials over each other, with their impacts at time 0. @implements {Step} */
class RunsPart {
  build() {
    this.known = new Known(); // the server's answer for a trial, by its path
    this.lists = new LatestRequest();
    this.requests = new LatestRequest();
    this.choice = new Choice('runs', () => this.draw());
    this.signal = h('select', {id: 'overlay-signal', onchange: () => this.draw()});
    this.plot = plotPlace('Runs over each other', {id: 'overlay-plot', role: 'figure'});
    this.note = note('');
    return h('div', {}, this.choice.node, labelled('signal', this.signal), this.note, this.plot);
  }

  async update() {
    const campaigns = state.workspace.campaigns.filter((campaign) => campaign.present && !campaign.error);
    const key = campaigns.map((campaign) => `${campaign.path} ${campaign.present}`).join();
    if (key === this.key) return;
    this.key = key;
    const turn = this.lists.begin();
    const entry = (path, name) => ({key: `${path}/${name}`, text: `${path}: ${name.replaceAll('__', ' ')}`,
      last: name.startsWith('none__') ? 1 : 0}); // free motion
    try {
      const entries = await Promise.all(campaigns.map(async ({path}) =>
        (await turn.ask(`/api/trials?${query({path})}`)).map((name) => entry(path, name))));
      this.choice.offer(entries.flat());
    } catch (error) { this.note.replaceChildren(mistake(error)); }
  }

  async draw() {
    const turn = this.requests.begin(), chosen = this.choice.selected();
    this.note.textContent = chosen.length ? `Reading ${count(chosen.length, 'run')} …` : '';
    const read = ({key: path}) => this.known.of(path, () => ask(`/api/trial?${query({path})}`));
    try {
      const trials = await turn.of(Promise.all(chosen.map(read))), curves = trials.map(curvesOf);
      fill(this.signal, plain([...new Set(curves.flatMap((curve) => Object.keys(curve)))]));
      const name = this.signal.value, data = [];
      chosen.forEach((entry, index) => {
        const curve = curves[index][name], zero = trials[index].replay.runs[0].impact ?? 0;
        if (curve) {
          data.push({x: Array.from(curve.x, (time) => time - zero), y: curve.y, name: entry.text, mode: 'lines',
            line: this.choice.lineOf(index, entry), hovertemplate: '%{y:.4g}'});
        }
      });
      this.note.textContent = chosen.length ? 'Impacts are at time 0.' : 'Choose runs from the list.';
      const axis = curves.map((curve) => curve[name]?.axis).find(Boolean) ?? '';
      await drawOverlay(this.plot, data, 'time since the impact [s]', `${name} ${axis}`);
      this.plot.dataset.shown = chosen.map((entry) => entry.key).join();
    } catch (error) { this.note.replaceChildren(mistake(error)); }
  }
}

// ---- models -------------------------------------------------------------------------------------------------------

/** Predictions of models for one measured run, each from a comparison in the folder. @implements {Step} */
class ModelsPart {
  build() {
    this.known = new Known(); // what a comparison holds, by its path and its time
    this.requests = new LatestRequest();
    this.choice = new Choice('models', () => this.draw());
    this.run = h('select', {id: 'overlay-run', onchange: () => this.draw()});
    this.signal = h('select', {id: 'overlay-model-signal', onchange: () => this.draw()});
    this.plot = plotPlace('Models over each other', {id: 'overlay-models-plot', role: 'figure'});
    this.note = h('div', {});
    return h('div', {}, this.choice.node,
      h('div', {class: 'fields'}, labelled('run', this.run), labelled('signal', this.signal)), this.note, this.plot);
  }

  update() {
    const pages = state.workspace.reports.filter((path) => path.endsWith('compare.html'));
    this.choice.offer(pages.map((path) => ({key: path, stamp: state.workspace.stamps[path], text: folderOf(path)})));
  }

  /** @param {string} path */
  async read(path) {
    const summary = ask(`/api/comparison?${query({path: folderOf(path)})}`);
    const [tracks, scores] = await Promise.all([tracksOf(path), summary]);
    return {sets: tracks?.sets ?? [], ...scores};
  }

  async draw() {
    const turn = this.requests.begin(), chosen = this.choice.selected();
    /** @param {Entry} entry */
    const read = ({key, stamp}) => this.known.of(`${key}?${stamp}`, () => this.read(key));
    try {
      const comparisons = await turn.of(Promise.all(chosen.map(read)));
      fill(this.run, plain([...new Set(comparisons.flatMap((item) => item.sets.map((set) => set.label)))]));
      const sets = comparisons.map((item) => item.sets.find((set) => set.label === this.run.value));
      fill(this.signal, plain([...new Set(sets.flatMap((set) => set?.signals.map((signal) => signal.name) ?? []))]));
      const name = this.signal.value, signals = sets.map((set) => set?.signals.find((signal) => signal.name === name));
      const data = [];
      chosen.forEach((item, index) => {
        const signal = signals[index];
        if (!signal) return;
        const x = floats(sets[index].time), curve = (values, title, line) =>
          data.push({x, y: floats(values), name: title, mode: 'lines', line});
        if (!data.length) curve(signal.measured, 'measured', {color: INK, width: 2});
        const line = {...this.choice.lineOf(index, item), dash: 'dash'};
        curve(signal.predicted, `${comparisons[index].model} (${item.text})`, line);
      });
      const scores = chosen.map(({text}, index) =>
        [comparisons[index].model, text, number(comparisons[index].score), number(comparisons[index].floor)]);
      this.note.replaceChildren(chosen.length ? table({}, ['model', 'comparison', 'score', 'noise'], scores, 2) :
        note('Compare models with measurements first; each comparison appears in the list.'));
      await drawOverlay(this.plot, data, 'time [s]', withUnit(name, signals.findLast(Boolean)?.unit));
      this.plot.dataset.shown = chosen.map((item) => item.text).join();
    } catch (error) { this.note.replaceChildren(mistake(error)); }
  }
}

// ---- estimates ----------------------------------------------------------------------------------------------------

const SHORTEST_MARGIN = 60_000; // ms, before the first and after the last estimate
const MARGIN_SHARE = 0.08; // of the time between the first and the last

// Estimates with their intervals as a trace.
const estimatesTrace = (rows, name, color, symbol) => ({
  x: rows.map((row) => new Date(1000 * row.when)), y: rows.map((row) => row.estimate), name, mode: 'markers',
  marker: {color, size: 11, symbol}, text: rows.map((row) => `${row.diagnosis}<br>${row.model}: ${row.verdict}`),
  error_y: {type: 'data', symmetric: false, array: rows.map((row) => (row.high ?? row.estimate) - row.estimate),
    arrayminus: rows.map((row) => row.estimate - (row.low ?? row.estimate)), color, thickness: 2},
  hovertemplate: '%{y:.4g}<br>%{text}<extra></extra>'});

/** The estimates of one parameter, diagnosis after diagnosis. @implements {Step} */
class EstimatesPart {
  build() {
    this.requests = new LatestRequest();
    /** @type {any[] | null} */
    this.estimates = null;
    this.parameter = h('select', {id: 'overlay-parameter', onchange: () => this.draw()});
    this.label = labelled('parameter', this.parameter);
    this.plot = plotPlace('Estimates of a parameter', {id: 'overlay-estimates'});
    this.note = note('');
    return h('div', {}, this.label, this.note, this.plot);
  }

  async update() {
    const {diagnoses, stamps} = state.workspace, key = JSON.stringify(diagnoses.map(({path}) => [path, stamps[path]]));
    if (key === this.key) return;
    this.key = key;
    if (!this.estimates) {
      this.label.hidden = true;
      this.note.textContent = 'Reading the diagnoses and the times of their trials …';
    }
    try {
      this.estimates = await this.requests.begin().ask('/api/estimates');
      const many = (name) => this.estimates.filter((entry) => entry.parameter === name).length;
      const named = new Set(this.estimates.filter((entry) => entry.named).map((entry) => entry.parameter));
      const names = [...new Set(this.estimates.map((entry) => entry.parameter))]
        .sort((a, b) => Number(named.has(b)) - Number(named.has(a)) || many(b) - many(a));
      fill(this.parameter, names.map((name) => ({value: name, text: `${name} (${many(name)})`})));
      this.label.hidden = !names.length;
      if (names.length) await this.draw(); else this.note.textContent = 'No diagnosis yet: each one adds a point.';
    } catch (error) { this.note.replaceChildren(mistake(error)); }
  }

  async draw() {
    const name = this.parameter.value, points = this.estimates.filter((entry) => entry.parameter === name);
    const named = points.filter((estimate) => estimate.named), unnamed = points.filter((estimate) => !estimate.named);
    const data = [estimatesTrace(named, 'named', NAMED, 'circle'),
      estimatesTrace(unnamed, 'not named', NOT_NAMED, 'circle-open')].filter((trace) => trace.x.length);
    const times = points.map((estimate) => 1000 * estimate.when), first = Math.min(...times), last = Math.max(...times);
    const margin = Math.max(SHORTEST_MARGIN, MARGIN_SHARE * (last - first));
    const unknown = points.filter((estimate) => !estimate.measured).length;
    const many = count(points.length, 'diagnosis', 'diagnoses');
    this.note.textContent = `${many}, each at the time of its last trial; bars are 95 % intervals.` +
      (unknown ? ` For ${unknown} of them this time is unknown, and the time of the file is used.` : '');
    await draw(this.plot, {data, layout: {height: 360, margin: {l: 60, r: 12, t: 10, b: 80}, showlegend: true,
      xaxis: {title: {text: 'time of the measurement'}, type: 'date', nticks: 6,
        range: [new Date(first - margin), new Date(last + margin)]},
      yaxis: {title: {text: withUnit(name, points[0].unit)}, automargin: true}, legend: LEGEND_BELOW}});
    this.plot.dataset.shown = name;
  }
}

export const overlay = new Tabbed('Overlay', {runs: ['Runs', new RunsPart()], models: ['Models', new ModelsPart()],
  estimates: ['Estimates', new EstimatesPart()]}, 'overlay-');
