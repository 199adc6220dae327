// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Recorded trials of campaigns and runs of laboratories, in 3D and as signals over time.

import {cursor, draw, plotPlace} from '../figures.js';
import {replayIn} from '../picture.js';
import {reading} from '../results.js';
import {button, fill, h, labelled, LatestRequest, mistake, note, query, refill, state} from '../tools.js';

/** @typedef {import('../types.d.ts').Step} Step */

/** @typedef {{path: string, run?: string}} Trial a trial, or a run of the laboratory at the path */

/** A trial in 3D and above its signals. */
export class TrialView {
  /** @param {string} name */
  constructor(name) {
    this.name = name;
    this.requests = new LatestRequest();
    this.node = h('div', {id: `${name}-shown`});
  }

  /** @param {Trial} trial */
  async open(trial) {
    this.node.replaceChildren(reading(trial.run ?? trial.path));
    const turn = this.requests.begin();
    try {
      const page = await turn.ask(`/api/${trial.run ? 'run' : 'trial'}?${query(trial)}`);
      const replay = h('div', {id: `${this.name}-replay`});
      const plots = page.plots.map(({title, figure}) => ({title, figure, node: plotPlace(title)}));
      this.node.replaceChildren(h('h3', {}, page.title), replay,
        ...plots.flatMap(({title, node}) => [h('h3', {}, title), node]), ...page.facts.map((text) => note(text)));
      await turn.of(Promise.all(plots.map(({figure, node}) => draw(node, figure))));
      const view = await turn.of(replayIn(replay, page.replay,
        {onSeek: (time) => { for (const {node} of plots) cursor(node, time); }}));
      for (const {node} of plots) {
        node.on('plotly_click', ({points: [point]}) => view.seek(point.x));
        node.on('plotly_afterplot', () => cursor(node, view.time)); // also when its width has changed
        cursor(node, view.time);
      }
    } catch (error) { this.failed(error); }
  }

  /** @param {Error} error */
  failed(error) { this.node.replaceChildren(mistake(error)); }
}

/**
 * Trials of a campaign and runs of a laboratory: a click opens one. While a campaign runs, its newest trial is shown.
 * @implements {Step}
 */
class RecordedPart {
  build() {
    this.lists = new LatestRequest();
    /** @type {string | undefined} folder that is chosen as soon as it is there */
    this.wanted = undefined;
    this.folder = h('select', {id: 'recorded-campaign', onchange: () => this.list()});
    this.follow = h('input', {type: 'checkbox', id: 'recorded-follow', checked: true});
    this.none = note('No trials yet.');
    this.trials = h('ul', {class: 'chips', id: 'recorded-trials'});
    this.view = new TrialView('recorded');
    this.fields = h('div', {class: 'fields'}, labelled('campaign or laboratory', this.folder),
      h('label', {class: 'tick'}, this.follow, 'show the newest trial while it runs'));
    return h('div', {}, this.none, this.fields, this.trials, this.view.node);
  }

  // Campaigns with trials, and described laboratories, with the number of their recordings.
  folders() {
    const {campaigns, laboratories} = state.workspace;
    const tried = campaigns.filter((campaign) => !campaign.error && campaign.present);
    const described = laboratories.filter((lab) => lab.experiment && !lab.error && lab.recordings.length);
    const entry = (path, many, text, lab) => ({path, many, text: `${path} (${text})`, lab});
    return [...tried.map(({path, present, trials}) => entry(path, present, `${present} of ${trials}`, false)),
      ...described.map(({path, recordings}) => entry(path, recordings.length, 'laboratory', true))];
  }

  update() {
    const folders = this.folders();
    this.none.hidden = folders.length > 0;
    this.fields.hidden = !folders.length;
    fill(this.folder, folders.map(({path, text}) => ({value: path, text})), this.wanted);
    this.wanted = undefined;
    const key = `${this.folder.value} ${folders.find((entry) => entry.path === this.folder.value)?.many}`;
    if (folders.length && key !== this.listed) { this.listed = key; this.list(); }
  }

  async list() {
    const path = this.folder.value, turn = this.lists.begin();
    const {lab} = this.folders().find((folder) => folder.path === path);
    /** @type {string[]} */
    let names;
    try { names = await turn.ask(`/api/trials?${query({path})}`); } catch (error) { this.view.failed(error); return; }
    const fresh = names.filter((name) => !(this.names ?? names).includes(name)), same = this.path === path;
    this.names = names;
    this.path = path;
    this.lab = lab;
    refill(this.trials, names.map((name) => h('li', {}, button(name.replaceAll('__', ' '), () => this.open(name),
      {'data-trial': name, 'aria-pressed': String(this.opened === `${path}/${name}`)}))));
    if (same && fresh.length && this.follow.checked) this.open(fresh.at(-1));
  }

  /** @param {string} name */
  open(name) {
    this.opened = `${this.path}/${name}`;
    for (const item of this.trials.querySelectorAll('button')) {
      item.setAttribute('aria-pressed', String(item.dataset.trial === name));
    }
    this.view.open(this.lab ? {path: this.path, run: name} : {path: this.opened});
  }
}

export const recorded = new RecordedPart();
