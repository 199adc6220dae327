// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Add: a better model from a diagnosis, and effects of the user's own as formulas.

import {commandForm, free} from '../forms.js';
import {go} from '../navigation.js';
import {ask, button, commandLine, h, labelled, LatestRequest, mistake, note, query, state} from '../tools.js';

/** @typedef {import('../types.d.ts').Step} Step */

const EXAMPLE = `effects:
- name: cable_drag
  sentence: A cable drags behind the end effector.
  end_effector_force: {y: "-drag * vy"}
  parameters:
    drag: {unit: N s/m, nominal: 0, lower: 0, upper: 50, scale: 1}
`;
const TYPING = 150; // ms without a key, after which a formula is checked

/** @implements {Step} */
class Add {
  constructor() {
    this.requests = new LatestRequest(); // of the diagnosis
    this.texts = new LatestRequest(); // of the formula
    /** @type {string | null} path of the diagnosed model */
    this.parent = null;
    /** @type {{file: string, effect: string} | null} what is chosen next */
    this.wanted = null;
  }

  build() {
    const form = this.form = commandForm('add', 'Add the effects', {offers: ['effect'], first: 'source',
      ready: () => this.parent && form.value('effect')?.length,
      suggest: {model: () => this.parent ?? 'nominal', output: () => this.next()}});
    form.control('source').addEventListener('change', () => this.choose());
    this.note = note('');
    this.text = h('textarea', {id: 'formula', spellcheck: 'false', 'aria-label': 'effect as a formula, in YAML',
      oninput: () => this.check()});
    this.text.value = EXAMPLE;
    this.checked = h('div', {id: 'formula-check', 'aria-live': 'polite'});
    this.file = h('input', {value: 'formulas/mine.yaml', id: 'formula-file'});
    this.save = button('Save the formulas', () => this.keep());
    return h('section', {}, h('h2', {}, 'A better model'), h('h3', {}, 'Add diagnosed effects'), this.note, form.node,
      h('h3', {}, 'Your own effect'), note('The formula is checked while you write. Save it to use it in Diagnose.'),
      this.text, this.checked, h('div', {class: 'fields'}, labelled('file', this.file)),
      h('div', {class: 'actions'}, this.save));
  }

  update() {
    this.form.update();
    if (this.wanted) this.form.choose('source', this.wanted.file);
    const file = this.form.value('source');
    if (!file) this.note.textContent = 'No diagnosis yet.';
    if (file !== this.opened || this.wanted || state.workspace.stamps[file] !== this.stamp) this.choose();
    if (!this.wasChecked) { this.wasChecked = true; this.check(); }
  }

  /** Opens the step with an effect of a diagnosis. @param {string} file @param {string} effect */
  start(file, effect) {
    this.wanted = {file, effect};
    go('add');
  }

  async choose() {
    const path = this.opened = this.form.value('source'), turn = this.requests.begin();
    if (!path) return;
    this.stamp = state.workspace.stamps[path];
    this.parent = null; // of the earlier diagnosis
    this.form.offer('effect', []);
    this.note.textContent = `Reading ${path} …`;
    this.form.refresh();
    try {
      const diagnosis = await turn.ask(`/api/diagnosis?${query({path})}`);
      this.parent = state.workspace.models.find((model) => model.digest === diagnosis.digest)?.path ?? null;
      this.note.textContent = this.parent ? `Diagnosis of ${diagnosis.model}: ${diagnosis.summary}` :
        `The diagnosed model ${diagnosis.model} is not in this folder.`;
      this.offer(diagnosis);
      this.form.refresh();
    } catch (error) { this.note.textContent = error.message; }
  }

  // Effects of a diagnosis: the named ones come first and are ticked; where there are none, the best one.
  offer({effects, named}) {
    const rank = ({name}) => named.includes(name) ? 0 : 1, order = [...effects].sort((a, b) => rank(a) - rank(b));
    const best = order.slice(0, 1).map((effect) => effect.name);
    const ticked = this.wanted?.effect ? [this.wanted.effect] : named.length ? named : best;
    const text = ({name, verdict, of_measurement: faulty}) =>
      `${name}: ${verdict}${faulty ? ' (a fault of the readings: goes into the calibration)' : ''}`;
    this.form.offer('effect', order.map((effect) =>
      ({value: effect.name, text: text(effect), on: ticked.includes(effect.name)})));
    this.wanted = null;
  }

  // A file that does not exist yet; the first model is the nominal one.
  next() {
    const used = (state.workspace?.models ?? []).map((model) => model.path);
    return free((many) => `models/model_${many + 1}.yaml`, used);
  }

  async check() {
    const turn = this.texts.begin();
    await turn.pause(TYPING);
    try {
      const {effects} = await turn.ask('/api/formulas/check', {text: this.text.value});
      this.checked.replaceChildren(...effects.map(({name, sentence, lines}) => h('div', {},
        h('p', {class: 'good'}, `✓ ${name}: ${sentence}`), h('ul', {}, ...lines.map((line) => h('li', {}, line))))));
      this.save.disabled = false;
    } catch (error) {
      this.checked.replaceChildren(mistake(error));
      this.save.disabled = true;
    }
  }

  async keep() {
    try {
      const saved = ask('/api/formulas', {path: this.file.value, text: this.text.value}); // which is not aborted
      const {command} = await this.texts.begin().of(saved);
      this.checked.replaceChildren(h('p', {class: 'good'}, `Saved as ${this.file.value}.`), commandLine(command));
    } catch (error) { this.checked.replaceChildren(mistake(error)); }
  }
}

export const add = new Add();
