// SPDX-License-Identifier: Apache-2.0
// Runs, models and estimates over each other: choose, filter, pin.

import {draw} from './figures.js';
import {ask, fill, h, inFolder, labelled, number, plain, query, Questions, state, Tabs} from './tools.js';

const COLOURS = ['#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9', '#555555', '#7A5195', '#003F5C', '#BC5090'];
const FIRST = 3; // runs that are chosen at first
const MOST = 60; // rows of the list
const MOST_CHOSEN = 30; // runs over each other: more curves are one blot

let kept = null; // what was chosen before, asked for once

// A list to choose from, with a filter and pins: pinned entries stay on top and chosen. The server keeps what was chosen.
class Choice {
  constructor(name, drawn) {
    Object.assign(this, {name, drawn, all: [], chosen: new Set(), pinned: new Set(), questions: new Questions()});
    this.filter = h('input', {type: 'search', id: `${name}-filter`, placeholder: 'all', oninput: () => this.show()});
    this.list = h('ul', {class: 'runs', id: `${name}-list`});
    const act = (text, change) => h('button', {type: 'button', onclick: () => { change(); this.show(); this.changed(); }}, text);
    this.node = h('div', {}, labelled('filter', this.filter), h('div', {class: 'actions'},
      act('Choose all below', () => { for (const one of this.fitting().slice(0, MOST_CHOSEN)) this.chosen.add(one.key); }),
      act('Choose none', () => { this.chosen = new Set(this.pinned); })), this.list);
  }

  // The user has changed the choice.
  async changed() {
    this.touched = true;
    this.drawn();
    const turn = this.questions.begin();
    await turn.pause(200); // of several clicks the last
    await ask('/api/choices', {name: this.name.replace('overlay-', ''), chosen: [...this.chosen], pinned: [...this.pinned]})
      .catch(() => {}); // the page shows it all the same
  }

  async offer(all) {
    if (JSON.stringify(all) === JSON.stringify(this.all)) return;
    this.all = all;
    kept ??= ask('/api/choices').catch(() => ({}));
    const own = (await kept)[this.name.replace('overlay-', '')];
    if (this.all !== all) return; // there are others meanwhile
    if (own && !this.touched) {
      this.touched = true;
      this.chosen = new Set(own.chosen);
      this.pinned = new Set(own.pinned);
    }
    for (const set of [this.chosen, this.pinned]) for (const key of set) if (!all.some((one) => one.key === key)) set.delete(key);
    const first = [...all].sort((a, b) => (a.last ?? 0) - (b.last ?? 0));
    if (!this.touched && !this.chosen.size) for (const one of first.slice(0, FIRST)) this.chosen.add(one.key);
    this.show();
    this.drawn();
  }

  // In the order of the list, the pinned ones first.
  selected() {
    const own = this.all.filter((one) => this.chosen.has(one.key));
    return [...own.filter((one) => this.pinned.has(one.key)), ...own.filter((one) => !this.pinned.has(one.key))];
  }

  // What all words of the filter are in.
  fitting() {
    const words = this.filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    return this.all.filter((one) => words.every((word) => one.text.toLowerCase().includes(word)));
  }

  show() {
    const shown = [...this.all.filter((one) => this.pinned.has(one.key)), ...this.fitting().filter((one) => !this.pinned.has(one.key))];
    const row = (one) => {
      const tick = h('input', {type: 'checkbox', onchange: ({target}) => {
        if (target.checked) this.chosen.add(one.key); else this.chosen.delete(one.key);
        this.changed();
      }});
      tick.checked = this.chosen.has(one.key);
      const pinned = this.pinned.has(one.key);
      return h('li', {'data-key': one.key}, h('label', {}, tick, one.text), h('button', {type: 'button', 'aria-pressed': String(pinned),
        'aria-label': `pin ${one.text}`, title: 'pin', onclick: () => {
          if (pinned) this.pinned.delete(one.key); else { this.pinned.add(one.key); this.chosen.add(one.key); }
          this.show();
          this.changed();
        }}, pinned ? '★' : '☆'));
    };
    const more = shown.length > MOST ? [h('li', {class: 'quiet'}, `${shown.length - MOST} more: type into the filter`)] : [];
    this.list.replaceChildren(...shown.slice(0, MOST).map(row), ...more, ...(shown.length ? [] : [h('li', {class: 'quiet'}, 'none')]));
  }
}

function floats(text) {
  return new Float32Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
}

// Values of a Plotly trace along x: an array, packed numbers, or even steps.
function abscissae(trace) {
  const unpacked = (values) => values?.bdata ? floats(values.bdata) : values;
  const y = unpacked(trace.y), x = unpacked(trace.x);
  return {y, x: x ?? Array.from(y, (_, i) => trace.x0 + i * trace.dx)};
}

const failed = (node) => (error) => node.replaceChildren(h('p', {class: 'error', role: 'alert'}, inFolder(error.message)));

// Answers by key; what has failed is asked for again.
class Known extends Map {
  of(key, make) {
    if (!this.has(key)) {
      this.set(key, make());
      this.get(key).catch(() => this.delete(key));
    }
    return this.get(key);
  }
}

// Recorded trials over each other, with their impacts at time 0.
const runs = {
  known: new Known(), // what the server says of a trial, by its path
  lists: new Questions(),
  questions: new Questions(),

  build() {
    this.choice = new Choice('overlay-runs', () => this.draw());
    this.signal = h('select', {id: 'overlay-signal', onchange: () => this.draw()});
    this.plot = h('div', {class: 'plot', id: 'overlay-plot', role: 'figure', 'aria-label': 'Runs over each other'});
    this.note = h('p', {class: 'note'});
    return h('div', {}, this.choice.node, labelled('signal', this.signal), this.note, this.plot);
  },

  async update() {
    const campaigns = state.workspace.campaigns.filter((one) => one.present && !one.error);
    const key = campaigns.map((one) => `${one.path} ${one.present}`).join();
    if (key === this.key) return;
    this.key = key;
    const turn = this.lists.begin();
    try {
      const found = await Promise.all(campaigns.map(async ({path}) => (await turn.ask(`/api/trials?${query({path})}`)).map((name) =>
        ({key: `${path}/${name}`, text: `${path}: ${name.replaceAll('__', ' ')}`, last: name.startsWith('none__') ? 1 : 0})))); // free motion
      this.choice.offer(found.flat());
    } catch (error) { failed(this.note)(error); }
  },

  async draw() {
    const turn = this.questions.begin(), chosen = this.choice.selected();
    this.note.textContent = chosen.length ? `Reading ${chosen.length} run${chosen.length === 1 ? '' : 's'} …` : '';
    try {
      const found = await turn.of(Promise.all(chosen.map(({key: path}) => this.known.of(path, () => ask(`/api/trial?${query({path})}`)))));
      const curves = found.map((one) => Object.fromEntries(one.plots.flatMap(({title, figure}) => figure.data.filter((trace) => trace.name)
        .map((trace) => [`${title}, ${trace.name}`, {...abscissae(trace), axis: figure.layout.yaxis.title.text}]))));
      const names = [...new Set(curves.flatMap((one) => Object.keys(one)))];
      fill(this.signal, plain(names));
      const name = this.signal.value, data = [];
      chosen.forEach(({text}, place) => {
        const curve = curves[place][name], zero = found[place].replay.runs[0].impact ?? 0;
        if (!curve) return;
        data.push({x: Array.from(curve.x, (time) => time - zero), y: curve.y, name: text, mode: 'lines',
          line: {color: COLOURS[place % COLOURS.length], width: this.choice.pinned.has(chosen[place].key) ? 3 : 1.5}, hovertemplate: '%{y:.4g}'});
      });
      this.note.textContent = chosen.length ? 'Impacts are at time 0.' : 'Choose runs from the list.';
      const unit = curves.map((one) => one[name]?.axis).find(Boolean) ?? '';
      await draw(this.plot, {data, layout: {height: 380 + 18 * data.length, margin: {l: 60, r: 12, t: 10, b: 60 + 18 * data.length}, showlegend: true,
        xaxis: {title: {text: 'time since the impact [s]'}}, yaxis: {title: {text: `${name} ${unit}`}, automargin: true},
        legend: {orientation: 'h', yref: 'container', y: 0, yanchor: 'bottom', x: 0, entrywidth: 1, entrywidthmode: 'fraction'}}}, {displayModeBar: 'hover'});
      this.plot.dataset.shown = chosen.map((one) => one.key).join();
    } catch (error) { failed(this.note)(error); }
  },
};

// Predictions of models on one measured run: each comparison in the folder is a model with its measurements.
const models = {
  known: new Known(),
  questions: new Questions(),

  build() {
    this.choice = new Choice('overlay-models', () => this.draw());
    this.run = h('select', {id: 'overlay-run', onchange: () => this.draw()});
    this.signal = h('select', {id: 'overlay-model-signal', onchange: () => this.draw()});
    this.plot = h('div', {class: 'plot', id: 'overlay-models-plot', role: 'figure', 'aria-label': 'Models over each other'});
    this.note = h('div', {});
    return h('div', {}, this.choice.node, h('div', {class: 'fields'}, labelled('run', this.run), labelled('signal', this.signal)), this.note, this.plot);
  },

  update() {
    const found = state.workspace.reports.filter((path) => path.endsWith('compare.html'));
    this.choice.offer(found.map((path) => ({key: path, stamp: state.workspace.stamps[path], text: path.replace(/\/?compare\.html$/, '')})));
  },

  async read(path) {
    const [text, summary] = await Promise.all([fetch(`/files/${path}`).then((answer) => answer.text()),
      ask(`/api/comparison?${query({path: path.replace(/\/?compare\.html$/, '') || '.'})}`)]);
    const data = new DOMParser().parseFromString(text, 'text/html').getElementById('tracks-data');
    return {sets: data ? JSON.parse(data.textContent) : [], ...summary};
  },

  async draw() {
    const turn = this.questions.begin(), chosen = this.choice.selected();
    try {
      const found = await turn.of(Promise.all(chosen.map(({key, stamp}) => this.known.of(`${key}?${stamp}`, () => this.read(key)))));
      fill(this.run, plain([...new Set(found.flatMap((one) => one.sets.map((set) => set.label)))]));
      const sets = found.map((one) => one.sets.find((set) => set.label === this.run.value));
      fill(this.signal, plain([...new Set(sets.flatMap((set) => set?.signals.map((one) => one.name) ?? []))]));
      const data = [];
      let unit = '';
      chosen.forEach(({text}, place) => {
        const set = sets[place], signal = set?.signals.find((one) => one.name === this.signal.value);
        if (!signal) return;
        unit = signal.unit ? ` [${signal.unit}]` : '';
        const time = floats(set.time);
        if (!data.length) data.push({x: time, y: floats(signal.measured), name: 'measured', mode: 'lines', line: {color: '#000000', width: 2}});
        data.push({x: time, y: floats(signal.predicted), name: `${found[place].model} (${text})`, mode: 'lines',
          line: {color: COLOURS[place % COLOURS.length], width: this.choice.pinned.has(chosen[place].key) ? 3 : 1.5, dash: 'dash'}});
      });
      this.note.replaceChildren(chosen.length ? h('div', {class: 'scroll'}, h('table', {}, h('thead', {}, h('tr', {}, ...['model', 'comparison', 'score', 'noise']
        .map((text, place) => h('th', {scope: 'col', class: place === 1 ? 'text' : null}, text)))), h('tbody', {}, ...chosen.map(({text}, place) => h('tr', {},
        h('td', {}, found[place].model), h('td', {class: 'text'}, text), h('td', {}, number(found[place].score)), h('td', {}, number(found[place].floor))))))) :
        h('p', {class: 'note'}, 'Compare models with measurements first; each comparison appears in the list.'));
      await draw(this.plot, {data, layout: {height: 380 + 18 * data.length, margin: {l: 60, r: 12, t: 10, b: 60 + 18 * data.length}, showlegend: true,
        xaxis: {title: {text: 'time [s]'}}, yaxis: {title: {text: `${this.signal.value}${unit}`}, automargin: true},
        legend: {orientation: 'h', yref: 'container', y: 0, yanchor: 'bottom', x: 0, entrywidth: 1, entrywidthmode: 'fraction'}}}, {displayModeBar: 'hover'});
      this.plot.dataset.shown = chosen.map((one) => one.text).join();
    } catch (error) { failed(this.note)(error); }
  },
};

// The estimate of one parameter, diagnosis after diagnosis.
const estimates = {
  questions: new Questions(),

  build() {
    this.parameter = h('select', {id: 'overlay-parameter', onchange: () => this.draw()});
    this.plot = h('div', {class: 'plot', id: 'overlay-estimates', role: 'img', 'aria-label': 'Estimates of a parameter'});
    this.note = h('p', {class: 'note'}, '');
    return h('div', {}, labelled('parameter', this.parameter), this.note, this.plot);
  },

  async update() {
    const key = JSON.stringify(state.workspace.diagnoses.map((one) => [one.path, state.workspace.stamps[one.path]]));
    if (key === this.key) return;
    this.key = key;
    if (!this.found) {
      this.parameter.parentElement.hidden = true;
      this.note.textContent = 'Reading the diagnoses and the times of their trials …';
    }
    try {
      this.found = await this.questions.begin().ask('/api/estimates');
      const count = (name) => this.found.filter((one) => one.parameter === name).length, named = new Set(this.found.filter((one) => one.named).map((one) => one.parameter));
      const names = [...new Set(this.found.map((one) => one.parameter))].sort((a, b) => named.has(b) - named.has(a) || count(b) - count(a));
      fill(this.parameter, names.map((name) => ({value: name, text: `${name} (${count(name)})`})));
      this.parameter.parentElement.hidden = !names.length;
      if (names.length) await this.draw(); else this.note.textContent = 'No diagnosis yet: each one adds a point.';
    } catch (error) { failed(this.note)(error); }
  },

  async draw() {
    const own = this.found.filter((one) => one.parameter === this.parameter.value), unit = own[0].unit === '-' ? '' : ` [${own[0].unit}]`;
    const of = (kind) => own.map((one) => one.named === kind ? one : null).filter(Boolean);
    const trace = (rows, name, colour, symbol) => ({x: rows.map((one) => new Date(1000 * one.when)), y: rows.map((one) => one.estimate), name, mode: 'markers',
      marker: {color: colour, size: 11, symbol}, text: rows.map((one) => `${one.diagnosis}<br>${one.model}: ${one.verdict}`),
      error_y: {type: 'data', symmetric: false, array: rows.map((one) => (one.high ?? one.estimate) - one.estimate),
        arrayminus: rows.map((one) => one.estimate - (one.low ?? one.estimate)), color: colour, thickness: 2},
      hovertemplate: '%{y:.4g}<br>%{text}<extra></extra>'});
    const data = [[true, 'named', '#009E73', 'circle'], [false, 'not named', '#777777', 'circle-open']]
      .map(([kind, ...look]) => trace(of(kind), ...look)).filter((one) => one.x.length);
    const times = own.map((one) => 1000 * one.when), wide = Math.max(60_000, 0.08 * (Math.max(...times) - Math.min(...times)));
    const unknown = own.filter((one) => !one.measured).length;
    this.note.textContent = `${own.length} diagnos${own.length === 1 ? 'is' : 'es'}, each at the time of its last trial; bars are 95 % intervals.` +
      (unknown ? ` ${unknown} of them do${unknown === 1 ? 'es' : ''} not say when that was, and stand${unknown === 1 ? 's' : ''} at the time of the file.` : '');
    await draw(this.plot, {data, layout: {height: 360, margin: {l: 60, r: 12, t: 10, b: 80}, showlegend: true, xaxis: {title: {text: 'time of the measurement'}, type: 'date', nticks: 6,
        range: [new Date(Math.min(...times) - wide), new Date(Math.max(...times) + wide)]},
      yaxis: {title: {text: `${this.parameter.value}${unit}`}, automargin: true}, legend: {orientation: 'h', yref: 'container', y: 0, yanchor: 'bottom', x: 0}}});
    this.plot.dataset.shown = this.parameter.value;
  },
};

const PARTS = {runs: ['Runs', runs], models: ['Models', models], estimates: ['Estimates', estimates]};

export const overlay = {
  build() {
    this.tabs = new Tabs(Object.fromEntries(Object.entries(PARTS).map(([name, [text, part]]) => [name, [text, part.build()]])), 'overlay-');
    return h('section', {}, h('h2', {}, 'Over each other'), this.tabs.list, this.tabs.lead, ...this.tabs.panels);
  },

  update() { PARTS[this.tabs.chosen][1].update(); },
};
