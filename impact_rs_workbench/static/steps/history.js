// SPDX-License-Identifier: Apache-2.0
// @ts-check
// History: the error from model to model, and packages of evidence.

import {says} from '../about.js';
import {commandForm, free, newestModel, runsChoices, runsForm} from '../forms.js';
import {Printed} from '../jobs.js';
import {Tabbed} from '../navigation.js';
import {wholeReport} from '../results.js';
import {count, h, slug, state} from '../tools.js';

/** @typedef {import('../types.d.ts').Step} Step */

/** The newest history of models. @implements {Step} */
class VersionsPart {
  build() {
    this.form = runsForm('history', 'Show the history', {model: newestModel});
    this.result = h('div', {id: 'history-result'});
    return h('div', {}, this.form.node, this.result);
  }

  update() {
    this.form.update();
    const {reports, stamps} = state.workspace;
    const [newest] = reports.filter((path) => path.endsWith('history.html')).sort((a, b) => stamps[b] - stamps[a]);
    const key = newest && `${newest} ${stamps[newest]}`;
    if (!newest || this.opened === key) return;
    this.opened = key;
    this.result.replaceChildren(...wholeReport(newest, true));
  }
}

/** @implements {Step} */
class EvidencePart {
  build() {
    const pack = commandForm('evidence pack', 'Pack the evidence', {
      ready: () => ['diagnosis', 'data'].every((name) => pack.value(name)), suggest: {
        diagnosis: () => state.workspace?.diagnoses[0]?.path, model: () => modelOf(pack.value('diagnosis')),
        data: () => runsChoices()[0]?.value, output: () => free((many) => outputOf(pack.value('laboratory'), many),
          state.workspace?.packages ?? [])}});
    const check = commandForm('evidence check', 'Check the package', {ready: () => check.value('package')});
    const merge = commandForm('evidence merge', 'Merge the packages', {ready: () => merge.value('packages').length,
      suggest: {output: () => 'evidence/merged.json'}});
    this.parts = [{title: 'Pack a diagnosis', form: pack, printed: new Printed('evidence pack')},
      {title: 'Check a package', form: check, printed: new Printed('evidence check')},
      {title: 'Merge several packages', form: merge, printed: new Printed('evidence merge')}];
    const nodes = this.parts.flatMap(({title, form, printed}) => [h('h3', {}, title), form.node, printed.node]);
    return h('div', {}, ...nodes);
  }

  update() {
    for (const {form, printed} of this.parts) { form.update(); printed.update(); }
    const {packages} = state.workspace;
    says('history/evidence', packages.length ? `${count(packages.length, 'package')}: ${packages.join(', ')}.` : '');
  }
}

const outputOf = (laboratory, many) => `evidence/${slug(laboratory ?? 'laboratory')}${many > 1 ? `_${many}` : ''}.json`;

// The model of a diagnosis.
function modelOf(diagnosis) {
  const digest = state.workspace?.diagnoses.find((entry) => entry.path === diagnosis)?.digest;
  return state.workspace?.models.find((model) => model.digest === digest)?.path ?? 'nominal';
}

export const versions = new VersionsPart();
export const history = new Tabbed('The error from model to model', {versions: ['Versions', versions],
  evidence: ['Evidence', new EvidencePart()]});
