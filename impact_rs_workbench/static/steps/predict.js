// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Predict: the impact map with a slider for each input, speed limits, and the study of designs.

import {says, showAbout} from '../about.js';
import {ABOUT} from '../explain.js';
import {darkScheme, draw, erase, legendHeight, LEGEND_BELOW, plotPlace, themed} from '../figures.js';
import {casesOf, free, listed, modelChoices} from '../forms.js';
import {inSight, Tabbed} from '../navigation.js';
import {ImpactScene} from '../picture.js';
import {
  ask, button, fill, fixed, h, interval, labelled, LatestRequest, messageArea, number, plain, query, state, stem,
  table, unit,
} from '../tools.js';
import {measure} from './measure.js';
import {PagePart} from './page_part.js';

/** @typedef {import('../types.d.ts').Step} Step */

const BAND = 'rgba(86,180,233,0.28)'; // of 95 % intervals
const INK = '#000000', OBJECT = '#E69F00';
const SMALL_VELOCITY = 5e-4; // m/s or rad/s, below which a row is left out
const MOST_SOURCES = 7; // of the interval, in the list
const SUPERSEDED_PAUSE = 300; // ms, until a question that gave way to another page's is asked again

/** @implements {Step} */
class ImpactPart {
  constructor() {
    this.values = {}; // of sliders that were moved, by their keys
    this.over = 'speed'; // key of the slider that the figure is drawn over
    /** @type {any} the next question, if one is under way */
    this.wanted = null;
    this.busy = false; // a question is under way
    this.moving = false; // a slider is held
    /** @type {any} curves over a slider */
    this.sweep = null;
    /** @type {any} what the numbers answer */
    this.question = null;
    /** @type {any} */
    this.answer = null;
    /** @type {any} what can be chosen in the scenario; null: it is being asked for */
    this.choices = null;
    this.scenarios = new LatestRequest();
    this.requests = new LatestRequest(); // of the choices above the sliders
    this.refinements = new LatestRequest(); // of sliders at rest
    this.turn = this.requests.begin();
  }

  build() {
    const list = (name, changed, ...options) => h('select', {id: `predict-${name}`, onchange: changed}, ...options);
    this.scenario = list('scenario', () => this.choose());
    this.object = list('object', () => this.objectChosen());
    this.case = list('case', () => this.anew());
    this.model = list('model', () => this.anew());
    this.inertia = list('inertia', () => this.anew(), new Option('B_θ (reduced)', 'reduced'),
      new Option('B_ρ (whole rotor)', 'rotor'), new Option('B = 0 (none)', 'zero'));
    this.arm = list('arm', () => this.anew());
    this.armLabel = labelled('arm in the figure', this.arm, {hidden: true});
    this.scene = h('div', {class: 'scene', id: 'predict-scene'});
    this.impact = new ImpactScene(this.scene);
    this.sliders = h('div', {class: 'sliders', id: 'sliders'});
    this.known = h('div', {class: 'sliders'});
    this.plot = plotPlace('Velocity after the impact', {id: 'predict-plot'});
    this.plot.redrawn = () => { if (this.answer) this.paint(); };
    darkScheme.addEventListener('change', () => { if (this.answer) this.paint(); });
    const velocities = table({id: 'predict-table'}, ['body, axis', 'before', 'after', '95 % interval'], [], 0);
    this.rows = velocities.querySelector('tbody');
    this.facts = h('p', {class: 'note', id: 'predict-facts'});
    this.budget = h('ul', {class: 'bars'});
    this.message = messageArea();
    this.numbers = h('div', {class: 'two', id: 'predict-numbers'}, h('div', {}, velocities, this.facts),
      h('div', {}, h('h3', {}, 'Sources of the interval'), this.budget));
    return h('div', {},
      h('div', {class: 'fields'}, labelled('scenario', this.scenario), labelled('object', this.object),
        labelled('case', this.case), labelled('model', this.model), labelled('motor inertia', this.inertia),
        this.armLabel),
      h('div', {class: 'beside'}, this.scene, h('div', {}, this.sliders,
        h('details', {}, h('summary', {}, 'Uncertainty of the inputs (95 %)'), this.known))),
      this.plot, this.message.node, this.numbers,
      h('div', {class: 'actions'}, button('Reset sliders', () => this.objectChosen()),
        button('Measure this', () => this.measure())));
  }

  async update() {
    fill(this.scenario, plain(state.workspace.scenarios), this.scenario.value || 'push');
    fill(this.model, modelChoices(), this.model.value || 'nominal');
    if (!this.chosen) await this.choose(); else if (this.model.value !== this.asked) this.anew();
  }

  /** A model of the folder. @param {string} path */
  chooseModel(path) {
    this.model.value = path;
    if (inSight('predict')) this.update();
  }

  async choose() {
    const name = this.chosen = this.scenario.value, turn = this.scenarios.begin();
    this.choices = null; // what the user chooses meanwhile is asked with the answer
    this.clear();
    try {
      const scenario = this.choices = await turn.ask(`/api/scenario?${query({name})}`);
      const objects = Object.entries(scenario.objects).map(([value, {label, mass}]) => ({value,
        text: `${label}, ${mass} kg`}));
      fill(this.object, objects, this.object.value || 'cat_food');
      fill(this.case, listed(casesOf(scenario)), this.case.value || 'case_2');
      fill(this.arm, plain(Object.keys(scenario.arms)));
      this.armLabel.hidden = this.arm.options.length < 2;
      this.objectChosen();
    } catch (error) { this.failed(error); }
  }

  // The question has changed: no answer to an earlier one stays under the new headings, or comes later.
  clear() {
    this.refinements.begin();
    this.sweep = this.answer = this.question = this.wanted = null;
    this.busy = this.moving = false;
    this.message.show();
    this.rows.replaceChildren();
    this.budget.replaceChildren();
    this.facts.textContent = 'Computing …';
    delete this.plot.dataset.shown;
    this.plot.style.minHeight = `${this.plot.offsetHeight}px`; // what is below stays where it is
    erase(this.plot);
    this.turn = this.requests.begin();
  }

  /** @param {Error} error */
  failed(error) {
    this.clear();
    this.numbers.removeAttribute('aria-busy');
    this.facts.textContent = '';
    this.message.error(error);
  }

  anew() {
    this.asked = this.model.value;
    this.clear();
    this.again();
  }

  objectChosen() {
    if (!this.choices) return;
    this.values = {};
    this.impact.ahead(this.scenario.value, this.object.value);
    const all = this.choices.sliders[this.object.value];
    this.over = all[0].key;
    this.sliders.replaceChildren(...all.filter((slider) => !slider.known).map((slider) => this.sliderOf(slider)));
    this.known.replaceChildren(...all.filter((slider) => slider.known).map((slider) => this.sliderOf(slider)));
    this.anew();
  }

  // A slider of an input, or of the uncertainty of one (`known`).
  sliderOf({key, label: name, meaning, low, high, value: nominal, unit: of, known, page}) {
    const text = (value) => `${number(value)}${unit(of)}`;
    const output = h('output', {}, text(nominal));
    const input = h('input', {type: 'range', min: low, max: high, step: (high - low) / 200, value: nominal,
      'data-key': key, title: meaning, 'aria-label': `${name} [${of}]`});
    input.value = nominal;
    const label = h('label', {}, h('span', {}, name), output, input);
    input.addEventListener('input', () => {
      const value = Number(input.value);
      this.values[key] = value;
      label.classList.add('moved');
      output.textContent = text(value);
      if (known && this.sweep) this.sweep = {...this.sweep, low: [], high: []};
      if (this.over !== key && !known) { this.over = key; this.sweep = null; }
      this.moving = true;
      this.again();
    });
    input.addEventListener('change', () => this.rest());
    input.addEventListener('focus', () => showAbout({title: name, text: meaning, page,
      facts: [`Scenario: ${text(nominal)}; key ${key}.`], equation: ABOUT.predict.equation}));
    return label;
  }

  // Velocities, with an interval from few draws. One question is under way at a time, and only the newest waits.
  async again() {
    if (!this.choices) return;
    this.refinements.begin();
    this.wanted = {scenario: this.scenario.value, object: this.object.value, case: this.case.value, arm: this.arm.value,
      model: this.model.value, motor_inertia: this.inertia.value, values: {...this.values}, moving: true};
    this.message.wait();
    this.numbers.setAttribute('aria-busy', 'true');
    if (this.busy) return;
    this.busy = true;
    const {turn} = this;
    while (this.wanted) {
      const question = this.wanted;
      this.wanted = null;
      try {
        this.show(await turn.ask('/api/predict', question), question);
        this.question = question;
      } catch (error) { if (!this.wanted) this.failed(error); }
    }
    this.busy = false;
    if (!this.moving) this.refine();
  }

  // A slider was let go.
  rest() {
    this.moving = false;
    if (!this.busy) this.refine();
  }

  // What takes longer: the interval of many draws with its budget, and then the curves over a slider.
  async refine() {
    if (!this.question) return;
    const turn = this.refinements.begin(), question = {...this.question, moving: false};
    await turn.painted();
    try {
      this.show(await this.undisturbed(turn, '/api/predict', question), question);
      await turn.painted();
      this.sweep = await this.undisturbed(turn, '/api/sweep', {...question, over: this.over});
      this.mark(question);
    } catch (error) { this.failed(error); }
  }

  // An answer that no question of another page has stopped.
  async undisturbed(turn, path, question) {
    for (;;) {
      const answer = await turn.ask(path, question);
      if (!answer.superseded) return answer;
      await turn.pause(SUPERSEDED_PAUSE);
    }
  }

  // Rows of a body with a velocity, and those of the contact.
  shownRows() {
    const largest = ({before, after}) => Math.max(Math.abs(before), Math.abs(after));
    return this.answer.rows.filter((row) => row.main || largest(row) > SMALL_VELOCITY);
  }

  // How the interval was computed.
  method() {
    const {moving, interval: computed} = this.answer;
    if (moving) return '; interval from few draws while a slider moves';
    if (!computed) return '';
    const method = {monte_carlo: 'Monte Carlo'}[computed.method] ?? computed.method.replace('_', ' ');
    return `; interval by ${method}, ${computed.draws} draws`;
  }

  show(answer, question) {
    this.answer = answer;
    this.message.command(answer.command);
    const cells = (row) => [`${row.body}, ${row.axis}`, fixed(row.before), fixed(row.after), interval(row, fixed)];
    this.rows.replaceChildren(...this.shownRows().map((row) =>
      h('tr', {class: row.main ? 'main' : ''}, ...cells(row).map((text) => h('td', {}, text)))));
    const impulses = Object.entries(answer.impulses), several = impulses.length > 1;
    const pushed = impulses.map(([arm, values]) =>
      `${several ? `${arm} ` : ''}[${values.map((value) => fixed(value)).join(', ')}]`).join(', ');
    const pads = several ? 'pads' : 'pad';
    this.facts.textContent = `m/s. Impulse of the ${pads} on the object ${pushed} N s${this.method()}. ${answer.note}`;
    this.numbers.removeAttribute('aria-busy');
    this.plot.style.minHeight = '';
    this.budget.classList.toggle('stale', answer.moving); // too few draws for shares
    const bar = ({source, share}) => h('li', {}, h('span', {}, source),
      h('i', {style: `width: ${(100 * share).toFixed(1)}%`}), h('span', {}, `${Math.round(100 * share)} %`));
    if (!answer.moving) this.budget.replaceChildren(...answer.budget.slice(0, MOST_SOURCES).map(bar));
    const main = answer.rows.filter((row) => row.main);
    const texts = main.map((row) => `${row.body} ${fixed(row.before, 2)} → ${fixed(row.after, 2)} m/s`);
    this.turn.of(this.impact.draw(question.scenario, question.object, answer.moment))
      .catch((error) => { this.scene.textContent = error.message; });
    says('predict/impact', `${texts.join(', ')}, along ${answer.axis}.`);
    this.mark(question);
  }

  // The row of the arm in the figure.
  row() { return this.answer.rows.find((row) => row.main && row.body === this.answer.arm); }

  slider() { return this.choices.sliders[this.object.value].find((slider) => slider.key === this.over); }

  // Markers of the current values: shapes, which Plotly moves without computing lines and axes again.
  marks() {
    const slider = this.slider(), x = this.values[slider.key] ?? slider.value;
    const row = this.row(), object = this.answer.rows.find((row) => row.main && row.body === 'object');
    const dot = (y, size, colour) => ({type: 'circle', xsizemode: 'pixel', ysizemode: 'pixel', xanchor: x, yanchor: y,
      x0: -size, x1: size, y0: -size, y1: size, fillcolor: themed(colour), line: {width: 0}});
    const bar = {type: 'line', x0: x, x1: x, y0: row.low, y1: row.high, line: {width: 4, color: themed(INK)}};
    return [...(row.low === null ? [] : [bar]), dot(row.after, 6, INK), dot(object.after, 4, OBJECT)];
  }

  async mark(question) {
    const {turn} = this;
    if (!this.plot.data) await turn.frame(); // numbers are painted before the library of the figures comes
    const quick = question.moving && this.onlyMarksMove();
    await turn.of(quick ? Plotly.relayout(this.plot, {shapes: this.marks()}) : this.paint());
    this.plot.dataset.shown = JSON.stringify(question.values);
  }

  // Whether the figure has the axes and curves of the answer, and room for its markers: alone they move ten times
  // faster.
  onlyMarksMove() {
    if (!this.plot.data || this.painted.over !== this.over || this.painted.sweep !== this.sweep) return false;
    const [low, high] = this.plot.layout.yaxis.range, within = (value) => low <= value && value <= high;
    return this.marks().every(({yanchor, y0, y1}) => (yanchor === undefined ? [y0, y1] : [yanchor]).every(within));
  }

  // The impact map over one slider, with markers of the current values.
  paint() {
    this.painted = {over: this.over, sweep: this.sweep};
    const slider = this.slider(), row = this.row(), data = [];
    const lines = this.sweep?.slider.key === slider.key ? this.sweep : null;
    if (lines) {
      data.push({x: [...lines.x, ...[...lines.x].reverse()], y: [...lines.high, ...[...lines.low].reverse()],
        fill: 'toself', fillcolor: BAND, line: {width: 0}, name: '95 % interval', hoverinfo: 'skip', mode: 'lines'});
      const curve = (y, name, line) =>
        data.push({x: lines.x, y, name, mode: 'lines', line, hovertemplate: '%{y:.3f} m/s'});
      for (const {y, label, colour, chosen} of lines.lines) {
        curve(y, label, {color: colour, width: chosen ? 3 : 1.5, dash: chosen ? 'solid' : 'dash'});
      }
      curve(lines.object, 'object', {color: OBJECT, width: 2, dash: 'dot'});
    }
    for (const [name, colour] of [[`${row.body}, here`, INK], ['object, here', OBJECT]]) { // for the legend
      data.push({x: [null], y: [null], mode: 'markers', name, marker: {color: colour, size: 11}});
    }
    const below = 52 + legendHeight(this.plot, 7, 72); // band, 3 maps, object, 2 markers
    const x = {text: `${slider.label} [${slider.unit}]`, standoff: 8};
    const y = {text: `v<sub>${this.answer.axis}</sub> after the impact [m/s]`};
    return draw(this.plot, {data, layout: {height: 250 + below, margin: {l: 60, r: 12, t: 10, b: below},
      hovermode: 'closest', shapes: this.marks(), legend: {...LEGEND_BELOW, font: {size: 11}},
      xaxis: {title: x, range: [slider.low, slider.high], zeroline: false},
      yaxis: {title: y, zeroline: true, automargin: true}}});
  }

  measure() { measure.choose({scenario: this.scenario.value, object: this.object.value, case: this.case.value}); }
}

const limits = new PagePart('limits', {run: 'Compute the limits', label: 'speed limits', page: 'limits.html',
  output: (part) => `limits/${stem(part.scenario())}`,
  opened: async (folder) => {
    const {scenario, limits: computed} = await ask(`/files/${folder}/limits.json`);
    const [least] = [...computed].sort((a, b) => a.limit_m_s - b.limit_m_s);
    const [limit, planned] = [least.limit_m_s, least.planned_m_s].map((speed) => `${number(speed)} m/s`);
    says('predict/limits', `${scenario}, ${least.object}, ${least.case}: limit ${limit}, planned ${planned}.`);
  }});

const designs = new PagePart('study-design', {run: 'Rank the designs', label: 'design study', page: 'design_study.html',
  output: (part) => free((many) => `designs/${many}`,
    state.workspace ? part.pages.choices().map((page) => page.value) : []),
  opened: (folder) => says('predict/designs', `The page below ranks the designs of ${folder}.`)});

export const impact = new ImpactPart();
export const predict = new Tabbed('Predict the effect of a hit', {impact: ['Impact', impact],
  limits: ['Speed limit', limits], designs: ['Design study', designs]});
