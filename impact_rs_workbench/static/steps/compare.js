// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Compare: the score of a model, maps of where it fails, and the signal of each cell over time and in 3D.

import {says} from '../about.js';
import {draw, floats, plotPlace} from '../figures.js';
import {runsChoices, runsForm} from '../forms.js';
import {whenDone} from '../jobs.js';
import {folderOf, replayOf, ResultChooser, tracksOf, wholeReport} from '../results.js';
import {h, labelled, LatestRequest, note, number, plain, query, state, unit} from '../tools.js';

/** @typedef {import('../types.d.ts').Step} Step */

const MOST_CELLS = 60; // in the list

/** @implements {Step} */
class Compare {
  build() {
    this.signals = new LatestRequest(); // of a cell of the opened report
    this.form = runsForm('compare', 'Compare');
    this.none = note('No measurements yet: run a campaign first, or practise on one with a hidden effect.');
    this.reports = new ResultChooser('compare-report', 'report', {choices: () => plain(this.files()),
      first: () => this.newest(), show: (path, turn, place) => this.open(path, turn, place)});
    whenDone('compare', ([folder]) => { this.reports.wanted = `${folder}/compare.html`; });
    whenDone('analyze', ([folder]) => { this.reports.wanted = `${folder}/report.html`; });
    return h('section', {}, h('h2', {}, 'Compare model and measurement'), this.none, this.form.node,
      ...this.reports.nodes);
  }

  update() {
    this.none.hidden = runsChoices().length > 0;
    this.form.update();
    this.reports.update();
  }

  files() { return state.workspace.reports.filter((path) => /(compare|report)\.html$/.test(path)); }

  // The newest comparison; an analysis (report.html) has no maps.
  newest() {
    const age = (path) => state.workspace.stamps[path] ?? 0;
    return this.files().filter((path) => path.endsWith('compare.html')).sort((a, b) => age(b) - age(a))[0];
  }

  /** @param {string} path @param {import('../tools.js').Turn} turn @param {HTMLElement} place */
  async open(path, turn, place) {
    this.signals.begin();
    if (path.endsWith('report.html')) {
      says('compare', `An analysis of measured jumps: ${path}.`);
      place.replaceChildren(...wholeReport(path, true));
    } else this.show(await turn.ask(`/api/comparison?${query({path: folderOf(path)})}`), path, turn, place);
  }

  show(comparison, path, turn, place) {
    this.yardstick = comparison.yardstick;
    this.tracks = null; // read once, when the first cell is opened
    this.signal = h('div', {id: 'signal'});
    this.replay = replayOf(path, turn);
    const open = (index) => this.openCell(comparison.cells[index], path);
    const name = ({row, column, map, error,
      times}) => `${row}, ${column} ${map ? `(${map})` : ''}: ${error}, ${times} ×`;
    const listed = comparison.cells.map((cell, index) => ({cell, index})).filter(({cell}) => cell.matters)
      .slice(0, MOST_CELLS);
    const choose = h('select', {'aria-label': 'cell', id: 'cell', onchange: () => open(Number(choose.value))},
      ...listed.map(({cell, index}) => new Option(name(cell), String(index))));
    const maps = comparison.figures.map(({title, figure}) =>
      ({title, figure, node: plotPlace(`Where the model fails: ${title}`, {class: 'plot clickable'})}));
    const score = number(comparison.score);
    says('compare', `${comparison.model}: score ${score}, where ${number(comparison.floor)} is noise.`);
    place.replaceChildren(h('p', {class: 'answer'}, h('b', {}, `Score ${score}`), comparison.headline),
      maps.length ? note(`Measured minus model, in multiples of ${comparison.yardstick} (blue: the measured value is ` +
        'larger, red: smaller). Click on a cell to see its signal over time.') : '',
      ...maps.flatMap(({title, node}) => [h('h3', {}, title), node]),
      comparison.cells.length ? labelled('or choose a cell, the worst first', choose) : '',
      this.signal, this.replay.node,
      ...wholeReport(path, false), ...comparison.remarks.map((text) => note(`Note: ${text}`)));
    for (const {title, figure, node} of maps) {
      draw(node, figure).then(() => node.on('plotly_click', ({points: [point]}) => {
        const clicked = ({row, column, map}) => row === point.y && column === point.x && (!map || map === title);
        const index = comparison.cells.findIndex(clicked);
        if (index < 0) return;
        choose.value = String(index);
        node.after(this.signal);
        open(index);
      }));
    }
  }

  // The signal that shows a cell best, measured and predicted, from the data of the report's own page.
  async openCell(cell, path) {
    this.tracks ??= tracksOf(path);
    const tracks = await this.signals.begin().of(this.tracks);
    if (!tracks) { this.signal.replaceChildren(note('This report has no signals over time.')); return; }
    const {sets, figure} = tracks, plot = plotPlace(`Signal of ${cell.row}`);
    const set = sets.find((set) => set.label.startsWith(cell.set)) ?? sets[0];
    const signal = set.signals.find((signal) => signal.name === cell.signal) ?? set.signals[0];
    this.signal.replaceChildren(h('h3', {}, `${signal.name}, ${set.label}`),
      note(`${cell.row} differs by ${cell.error}, ${cell.times} × ${this.yardstick}; this signal shows it best. ` +
        'Dotted: start of the impact.'), plot);
    draw(plot, trackFigure(figure, set, signal));
    this.replay.show(set.label, set.impact);
    this.signal.scrollIntoView({block: 'nearest'});
  }
}

// Measured, predicted and the residual, in the figure of the report.
function trackFigure({data, layout}, set, signal) {
  const x = floats(set.time), measured = floats(signal.measured), predicted = floats(signal.predicted);
  const residual = measured.map((value, index) => value - predicted[index]);
  const shown = unit(signal.unit) ? ` [${signal.unit}]` : '';
  const titled = (axis, text) => ({...axis, title: {text: `${text}${shown}`}});
  return {
    data: [measured, predicted, residual].map((y, index) => ({...data[index], x, y})),
    layout: {...layout, height: 420, yaxis: titled(layout.yaxis, 'signal'), yaxis2: titled(layout.yaxis2, 'residual'),
      shapes: layout.shapes.map((shape) => ({...shape, visible: set.impact !== null, x0: set.impact, x1: set.impact}))},
  };
}

export const compare = new Compare();
