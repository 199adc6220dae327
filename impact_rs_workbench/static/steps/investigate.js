// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Investigate: the whole loop by itself, and hits that are followed one by one.

import {says} from '../about.js';
import {commandForm, free, newestModel} from '../forms.js';
import {Printed, whenDone} from '../jobs.js';
import {Tabbed} from '../navigation.js';
import {foldersOf, ResultChooser, wholeReport} from '../results.js';
import {count, h, inFolder, plain, query, slug, state, stem} from '../tools.js';

/** @typedef {import('../types.d.ts').Step} Step */

const PAGE = 'report/investigation.html';

/** @implements {Step} */
class LoopPart {
  build() {
    this.form = commandForm('investigate', 'Investigate', {first: 'budget', suggest: {
      directory: () => free((many) => `investigations/${many}`, state.workspace ? foldersOf(PAGE) : [])}});
    this.folders = new ResultChooser('investigate-file', 'investigation', {choices: () => plain(foldersOf(PAGE)),
      file: (folder) => `${folder}/${PAGE}`, show: (folder, turn, place) => this.show(folder, turn, place)});
    whenDone('investigate', ([folder]) => { this.folders.wanted = folder; });
    return h('div', {}, this.form.node, ...this.folders.nodes);
  }

  update() { this.form.update(); this.folders.update(); }

  async show(folder, turn, place) {
    const {ending, rounds, trials} = await turn.ask(`/api/investigation?${query({path: folder})}`);
    const soFar = `${count(trials, 'trial')} in ${count(rounds, 'round')}`;
    says('investigate/loop', `${folder}: ${ending ? ending.verdict : 'not at its end'}, after ${soFar}.`);
    place.replaceChildren(h('p', {class: 'answer', id: 'ending'}, h('b', {}, ending ? ending.verdict : 'goes on'),
      ending ? ending.summary : `${soFar} so far.`), ...wholeReport(`${folder}/${PAGE}`, true));
  }
}

const modelPaths = () => (state.workspace?.models ?? []).map((model) => model.path);

/** @implements {Step} */
class FollowPart {
  build() {
    const form = this.form = commandForm('follow', 'Follow', {offers: ['runs'],
      ready: () => form.value('runs') || form.value('impacts'), suggest: {model: newestModel,
        state: () => `followed/${slug(form.value('runs') ?? stem(form.value('impacts') ?? 'hits'))}.npz`,
        output: () => free((many) => `models/followed_${many}.yaml`, modelPaths())}});
    this.printed = new Printed('follow', (job) => says('investigate/follow', job.ended === null ?
      `Job ${job.number} follows ${job.arguments[1]}.` :
        `Job ${job.number} has followed ${inFolder(job.arguments[1])}.`));
    return h('div', {}, form.node, this.printed.node);
  }

  update() {
    const runs = plain(state.workspace.runs), {form} = this;
    form.offer('runs', runs, form.value('runs') ?? (form.value('impacts') ? '' : runs[0]?.value));
    form.update();
    this.printed.update();
  }
}

export const follow = new FollowPart();
export const investigate = new Tabbed('Let the loop run by itself', {loop: ['Investigate', new LoopPart()],
  follow: ['Follow', follow]});
