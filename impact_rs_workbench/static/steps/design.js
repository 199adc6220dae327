// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Plans of trials, a tab of Measure: which trials come next.

import {says} from '../about.js';
import {commandForm, free} from '../forms.js';
import {jobButton, whenDone} from '../jobs.js';
import {go} from '../navigation.js';
import {ResultChooser} from '../results.js';
import {h, plain, query, state, stem, table} from '../tools.js';

/** @typedef {import('../types.d.ts').Step} Step */

/** @param {number} value */
const percent = (value) => `${(100 * value).toFixed(1)} %`;

/** @implements {Step} */
class DesignPart {
  build() {
    this.form = commandForm('design', 'Plan the trials', {first: 'budget', suggest: {budget: () => 18, runs: () => '',
      output: () => free((many) => `plans/plan_${many}.yaml`, state.workspace?.plans ?? [])}});
    this.plans = new ResultChooser('design-file', 'plan', {choices: () => plain(state.workspace.plans),
      show: async (path, turn, place) => this.show(await turn.ask(`/api/plan?${query({path})}`), path, place)});
    whenDone('design', ([path]) => { this.plans.wanted = path; });
    return h('div', {}, this.form.node, ...this.plans.nodes);
  }

  /** For what a diagnosis leaves open. @param {string} diagnosis @param {string} runs */
  after(diagnosis, runs) {
    go('measure', 'design');
    this.form.choose('after', diagnosis);
    if (runs) this.form.choose('runs', runs);
  }

  update() { this.form.update(); this.plans.update(); }

  show({trials, summary, conditions, pairs}, path, place) {
    says('measure/design', `${path}: ${trials} trials.`);
    place.replaceChildren(h('p', {class: 'answer'}, h('b', {}, `${trials} trials`), summary),
      h('div', {class: 'actions'}, ...jobButton('Run the plan',
        () => ({command: 'campaign', plan: path, output: `campaigns/${stem(path)}`}), {class: 'primary'})),
      table({id: 'planned'}, ['trials', 'condition', 'purpose'],
        conditions.map((condition) => [condition.trials, condition.what, condition.adds])));
    if (!pairs.length) return;
    place.append(h('h3', {}, 'Probability that the next diagnosis distinguishes two explanations, the lowest first'),
      table({id: 'pairs'}, ['explanation', 'other explanation', 'before', 'after'],
        pairs.map((pair) => [pair.first, pair.second, percent(pair.before), percent(pair.after)]), 2));
  }
}

export const design = new DesignPart();
