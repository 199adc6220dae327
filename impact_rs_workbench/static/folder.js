// SPDX-License-Identifier: Apache-2.0
// @ts-check
// The folder of the workbench, on the left: what lies in it leads to the steps that use it.

import {says, showAbout} from './about.js';
import {ABOUT} from './explain.js';
import {newestModel} from './forms.js';
import {jobButton} from './jobs.js';
import {go} from './navigation.js';
import {compare} from './steps/compare.js';
import {diagnose} from './steps/diagnose.js';
import {versions} from './steps/history.js';
import {describe, impacts} from './steps/laboratory.js';
import {impact} from './steps/predict.js';
import {recorded} from './steps/trials.js';
import {$, button, count, h, number, refill, state, unit} from './tools.js';

/** @typedef {import('./types.d.ts').Model} Model */

/** @param {import('./types.d.ts').Score} score */
function scoreText({fit, held_out: heldOut, floor, unit: of}) {
  const held = heldOut === null || heldOut === undefined ? '' : `, held out ${number(heldOut)}`;
  const noise = floor ? ` (noise ${number(floor)})` : '';
  return `error ${number(fit)}${unit(of.startsWith('times ') ? '' : of)}${held}${noise}`;
}

// The newest state of an entry, which may have changed since it was listed.
const newest = (kind, path) => state.workspace[kind].find((item) => item.path === path);

// ---- the first lines of steps that count what is there ------------------------------------------------------------

function sayWhatIsThere() {
  const {campaigns, models, diagnoses, blinds, reports} = state.workspace;
  const trials = campaigns.reduce((sum, {present}) => sum + present, 0), scored = models.filter(({score}) => score);
  const compared = reports.filter((path) => path.endsWith('compare.html')).length;
  const measured = campaigns.length ? `${count(trials, 'trial')} in ${count(campaigns.length, 'campaign')}.` : '';
  says('measure/campaign', measured);
  says('measure/recorded', measured);
  says('measure/blind', blinds.length ? `${count(blinds.length, 'practice campaign')}.` : '');
  says('add', models.length > 1 ? `${count(models.length, 'model')}; the newest is ` +
    `${models.find((model) => model.path === newestModel()).name}.` : '');
  says('overlay/runs', trials ? `${count(trials, 'trial')} to choose from.` : '');
  says('overlay/models', compared ? `${count(compared, 'comparison')} to choose from.` : '');
  const diagnosed = count(diagnoses.length, 'diagnosis', 'diagnoses');
  says('overlay/estimates', diagnoses.length ? `${diagnosed} to choose from.` : '');
  const scores = scored.map(({name, score}) => `${name} ${number(score.held_out ?? score.fit)}`);
  says('history/versions', scored.length ? `${scores.join(', ')} (noise ${number(scored[0].score.floor)}).` : '');
}

// ---- entries ------------------------------------------------------------------------------------------------------

/** @param {string} key @param {string} text @param {string[]} small lines below it @param {() => void} chosen */
function entry(key, text, small, chosen) {
  const choose = () => { state.chosen = key; showFolder(); chosen(); };
  const attributes = {type: 'button', 'data-entry': key, 'aria-pressed': String(state.chosen === key), onclick: choose};
  return h('li', {}, h('button', attributes, text, ...small.map((line) => h('small', {}, line))));
}

function campaignEntry({path, error, scenario, present, trials}) {
  return entry(`campaign ${path}`, path, [error || `${scenario ? `${scenario}, ` : ''}${present} of ${trials} trials`],
    () => chooseCampaign(newest('campaigns', path)));
}

function laboratoryEntry({path, error, experiment, recordings}) {
  const status = experiment ? 'described' : `${count(recordings.length, 'recording')}, not described`;
  return entry(`lab ${path}`, path === '.' ? 'this folder' : path, [error || status], () => chooseLaboratory(path));
}

function diagnosisEntry({path, model, verdict}) {
  return entry(`diagnosis ${path}`, path, [`${model}: ${verdict}`],
    () => { diagnose.diagnoses.wanted = path; go('diagnose'); });
}

/** Models with this parent, each with its own children. @param {string | null} parent @returns {HTMLLIElement[]} */
function modelBranch(parent) {
  const branch = state.workspace.models.filter((model) => model.parent === parent && model.path !== parent);
  return branch.map(({path, name, error, effects, score}) => {
    const small = [error || effects.join(' + ') || 'nothing added'], children = modelBranch(path);
    if (score) small.push(`${scoreText(score)}, in ${score.report}`);
    const item = entry(`model ${path}`, name, small, () => chooseModel(newest('models', path)));
    if (children.length) item.append(h('ul', {class: 'tree'}, ...children));
    return item;
  });
}

export function showFolder() {
  const {root, campaigns, laboratories, diagnoses} = state.workspace;
  sayWhatIsThere();
  const list = (id, items) => refill($(id), items.length ? items : [h('li', {class: 'quiet'}, 'none yet')]);
  $('root').textContent = root.split('/').pop();
  $('root').title = root;
  const focused = document.activeElement?.getAttribute('data-entry');
  list('campaigns', campaigns.map(campaignEntry));
  list('laboratories', laboratories.map(laboratoryEntry));
  list('models', modelBranch(null));
  list('diagnoses', diagnoses.map(diagnosisEntry));
  if (focused) /** @type {HTMLElement} */ (document.querySelector(`[data-entry="${CSS.escape(focused)}"]`))?.focus();
}

// ---- what a click does --------------------------------------------------------------------------------------------

function chooseCampaign({path, error, present, trials}) {
  if (present && !error) {
    recorded.wanted = path;
    go('measure', 'recorded');
  }
  const use = (text, step, form) => button(text, () => { go(step); form.choose('runs', path); });
  showAbout({...ABOUT.measure, title: path, facts: [error || `${present} of ${trials} trials are recorded.`,
    present < trials ? 'Run the same command again to continue.' : ''].filter(Boolean),
  actions: [use('Compare', 'compare', compare.form), use('Diagnose', 'diagnose', diagnose.form),
    ...jobButton('Analyze', () => ({command: 'analyze', directory: path}))]});
}

/** @param {string} path */
function chooseLaboratory(path) {
  go('laboratory', 'laboratory');
  describe.wanted = path;
  describe.update();
  const {experiment, error, recordings} = newest('laboratories', path);
  if (!experiment || error) return;
  const actions = [
    button('Show the runs', () => { recorded.wanted = path; go('measure', 'recorded'); }),
    button('Find the impacts', () => { go('laboratory', 'impacts'); impacts.form.choose('directory', path); }),
    button('Compare', () => { go('compare'); compare.form.choose('runs', path); }),
  ];
  showAbout({...ABOUT.laboratory, title: path, actions,
    facts: [`${count(recordings.length, 'recording')}, described in ${experiment}.`]});
}

/** @param {Model} model */
function chooseModel({path, name, note, error, effects, scores}) {
  if (!error) {
    for (const {form} of [compare, diagnose, versions]) form.choose('model', path);
    impact.chooseModel(path);
  }
  showAbout({title: name, text: note || 'Scenario and the effects added to it.', page: 'effects.md',
    facts: [error, effects.length ? `Effects: ${effects.join(', ')}.` : 'No effects: nominal values only.',
      ...scores.map((score) => `${score.report}: ${scoreText(score)}`)].filter(Boolean)});
}
