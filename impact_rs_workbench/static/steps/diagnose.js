// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Diagnose: the verdict, estimates, the ranking of effects, and what to do next.

import {says} from '../about.js';
import {draw, plotPlace} from '../figures.js';
import {diagnosisChoices, runsForm} from '../forms.js';
import {jobButton, onJobs, progressBar, progressText, whenDone} from '../jobs.js';
import {folderOf, replayOf, ResultChooser, wholeReport} from '../results.js';
import {button, h, note, number, query, slug, state, table, unit} from '../tools.js';
import {add} from './add.js';
import {design} from './design.js';
import {reveal} from './practice.js';

/** @typedef {import('../types.d.ts').Step} Step */

const MOST_EFFECTS = 12; // of the ranking
const TRIALS_OF_NEXT = 3; // of the next experiment

/** @implements {Step} */
class Diagnose {
  build() {
    this.form = runsForm('diagnose', 'Diagnose', {report: () => this.form.folder(),
      output: () => `${this.form.value('report') ?? this.form.folder()}/diagnosis.json`});
    this.progress = h('div', {});
    this.diagnoses = new ResultChooser('diagnose-file', 'diagnosis', {choices: diagnosisChoices,
      show: (path, turn, place) => this.open(path, turn, place)});
    const written = (paths) => { this.diagnoses.wanted = paths.find((path) => path.endsWith('.json')); };
    whenDone('diagnose', written);
    whenDone('discover', written);
    onJobs(() => this.showProgress());
    return h('section', {}, h('h2', {}, 'Find what the model lacks'), this.form.node, this.progress,
      ...this.diagnoses.nodes);
  }

  update() { this.form.update(); this.diagnoses.update(); }

  // Of a running diagnosis, with its ranking so far.
  showProgress() {
    const job = state.jobs.find((job) => job.arguments[0] === 'diagnose' && job.ended === null);
    const ranking = job?.progress?.ranking ?? [], largest = ranking.at(-1)?.[1];
    const bar = ([name, error]) => h('li', {}, h('span', {}, name),
      h('i', {style: `width: ${Math.min(100, 100 * error / largest).toFixed(1)}%`}), h('span', {}, number(error)));
    this.progress.replaceChildren(...(job ? [h('p', {role: 'status'}, progressText(job)), progressBar(job)] : []),
      ...(ranking.length ? [note('So far: held-out error with each effect; smaller is better.'),
        h('ol', {class: 'bars'}, ...ranking.map(bar))] : []));
  }

  /** @param {string} path @param {import('../tools.js').Turn} turn @param {HTMLElement} place */
  async open(path, turn, place) {
    const diagnosis = await turn.ask(`/api/diagnosis?${query({path})}`);
    const plot = plotPlace('Held-out error by effect');
    const report = path.replace(/[^/]*$/, diagnosis.report);
    const named = diagnosis.effects.filter((effect) => diagnosis.named.includes(effect.name));
    says('diagnose', `${diagnosis.model}: ${diagnosis.verdict}.`);
    place.replaceChildren(h('p', {class: 'answer', id: 'verdict'}, h('b', {}, diagnosis.verdict), diagnosis.summary),
      ...named.flatMap(estimates),
      h('h3', {}, 'Ranking'), note(`Held-out error without and with the effect, ${diagnosis.unit}.`), plot,
      ranking(diagnosis, path),
      diagnosis.left.length ? unexplained(diagnosis) : '',
      diagnosis.calls_for_a_law ? law(diagnosis, path) : '',
      diagnosis.practice ? practice(path) : '',
      diagnosis.calibrate.length ? calibrations(diagnosis) : '',
      diagnosis.next ? next(diagnosis.next, path, diagnosis.runs) : '',
      ...(state.workspace.reports.includes(report) ? [replayOf(report, turn).node, ...wholeReport(report, false)] :
        [note('This diagnosis has no report: name a folder of the report to get one.')]),
      ...diagnosis.remarks.map((text) => note(`Note: ${text}`)));
    if (diagnosis.figure) draw(plot, diagnosis.figure); else plot.remove();
  }
}

// Parameters of a named effect.
function estimates({name, parameters}) {
  const rows = parameters.map(({name: parameter, text: [estimate, ...ends], unit: of}) =>
    [parameter, estimate, ends.join(' … ') || '–', unit(of)]);
  return [h('h3', {}, name), table({}, ['parameter', 'estimate', '95 % interval', 'unit'], rows, 1)];
}

function ranking({effects}, path) {
  const row = ({name, sentence, verdict, without, with: with_, p, tag}) => {
    const errors = `${number(without)} → ${number(with_)}`;
    return h('tr', {class: tag === 'good' ? 'main' : ''}, h('td', {title: sentence}, name),
      h('td', {class: 'text'}, verdict),
      h('td', {}, errors), h('td', {}, p), h('td', {}, tag === 'no' ? '' : button('Add', () => add.start(path, name))));
  };
  return table({id: 'ranking'}, ['effect', 'verdict', 'without → with', 'p', 'add to the model'],
    effects.slice(0, MOST_EFFECTS).map(row), 2);
}

const unexplained = ({left, yardstick}) => h('div', {}, h('h3', {}, 'Unexplained'),
  h('ul', {}, ...left.map(({what, phase, value, times, floor}) =>
    h('li', {}, `${what} (${phase}): ${value}, ${times} × ${yardstick}; relevance limit ${floor}`))));

const calibrations = ({calibrate}) => h('div', {class: 'answer', id: 'calibrate'}, h('b', {}, 'Calibrate the readings'),
  ...calibrate.map(({effect, experiment}) => h('p', {}, h('code', {}, effect), `: ${experiment}.`)));

// An error that no effect explains may follow a law: discover gets the options of the diagnosis.
function law({law: options, digest}, path) {
  const inFolder = options.runs || options.impacts, folder = folderOf(path);
  const model = state.workspace.models.find((model) => model.digest === digest)?.path ?? options.model;
  const body = () => ({command: 'discover', ...options, model, report: folder,
    output: `${folder === '.' ? '' : `${folder}/`}discovery.json`});
  return h('div', {class: 'answer', id: 'law'}, h('b', {}, 'A law that the library does not have'),
    h('p', {}, 'A formula may explain the remaining error; if none holds, a curve describes it.'),
    inFolder ? h('div', {class: 'actions'}, ...jobButton('Look for a law', body, {class: 'primary'})) :
      note('The measurements of this diagnosis are not in this folder, or an earlier version wrote it. Diagnose them ' +
        'here, or use impact-rs discover in a terminal.'));
}

function practice(path) {
  const answer = h('div', {id: 'revealed'});
  const open = button('Reveal the hidden effect', () => reveal(path, answer), {id: 'reveal'});
  return h('div', {}, h('div', {class: 'actions'}, open, h('span', {class: 'note'}, 'of a practice campaign')), answer);
}

// Further trials are written next to the measured ones, so that the same RUNS contains them.
const nextFolder = (runs) => state.workspace.campaigns.some((campaign) => campaign.path === runs && campaign.scenario) ?
  runs.split('/').slice(0, -1).join('/') || 'campaigns' : runs || 'campaigns';

function next({advice, scenario, object, case: case_}, path, runs) {
  const output = () => `${nextFolder(runs)}/next_${slug(scenario)}_${slug(object ?? '')}`;
  const body = () => ({command: 'campaign', scenario, output: output(), objects: object ? [object] : null,
    cases: case_ ? [case_] : null, scales: [1], trials: TRIALS_OF_NEXT});
  return h('div', {class: 'answer'}, h('b', {}, 'Next experiment'), h('p', {}, advice), h('div', {class: 'actions'},
    ...(scenario ? jobButton('Run it', body, {class: 'primary'}) : []),
    button('Design more trials', () => design.after(path, runs), {id: 'design-next'})));
}

export const diagnose = new Diagnose();
