// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Results in the folder of the workbench: lists to choose one from, whole reports, and what a report's own page holds.

import {replayIn} from './picture.js';
import {fill, h, labelled, LatestRequest, mistake, plain, state} from './tools.js';

/** @typedef {import('./tools.js').Turn} Turn */

/** @param {string} path */
export const reading = (path) => h('p', {class: 'note', role: 'status'}, `Reading ${path} …`);

/**
 * A list of results, of which the chosen one is shown below it; again when its file has changed.
 */
export class ResultChooser {
  /**
   * @param {string} id of the list; that of the result ends in "-result"
   * @param {string} label
   * @param {object} source
   * @param {() => import('./types.d.ts').Option[]} source.choices
   * @param {(value: string, turn: Turn, place: HTMLElement) => void | Promise<void>} source.show fills the place
   * @param {(value: string) => string} [source.file] whose changes are followed
   * @param {() => string | undefined} [source.first] what is chosen at first
   */
  constructor(id, label, {choices, show, file = (value) => value, first = () => undefined}) {
    this.choices = choices;
    this.show = show;
    this.file = file;
    this.first = first;
    /** @type {string | null} is chosen as soon as it is there */
    this.wanted = null;
    /** @type {string | null} is shown */
    this.opened = null;
    this.stamp = 0; // time of the last change of the file that is shown
    this.requests = new LatestRequest();
    this.select = h('select', {id, onchange: () => this.open()});
    this.label = labelled(label, this.select);
    this.result = h('div', {id: id.replace(/-[a-z]+$/, '-result')});
    this.nodes = [this.label, this.result];
  }

  update() {
    const choices = this.choices(), has = (value) => choices.some((choice) => choice.value === value);
    fill(this.select, choices, this.wanted && has(this.wanted) ? this.wanted : this.opened ? undefined : this.first());
    this.label.hidden = !choices.length;
    const {value} = this.select;
    if (value && (value !== this.opened || state.workspace.stamps[this.file(value)] !== this.stamp)) this.open();
    if (this.wanted === value) this.wanted = null;
  }

  async open() {
    const value = this.opened = this.select.value, turn = this.requests.begin();
    this.stamp = state.workspace.stamps[this.file(value)];
    this.result.replaceChildren(reading(value));
    try { await this.show(value, turn, this.result); } catch (error) { this.result.replaceChildren(mistake(error)); }
  }
}

/** Folders with a page of a report. @param {string} page its path in the folder */
export const foldersOf = (page) => state.workspace.reports.filter((path) => path.endsWith(`/${page}`))
  .map((path) => path.slice(0, -page.length - 1));

/** Pages that one command writes, each in a folder of its own. */
export class Pages extends ResultChooser {
  /**
   * @param {string} name
   * @param {string} label
   * @param {string} page its file in the folder
   * @param {(folder: string) => void | Promise<void>} [opened] is given the folder of the page that is shown
   */
  constructor(name, label, page, opened = () => {}) {
    super(`${name}-page`, label, {choices: () => plain(foldersOf(page)), file: (folder) => `${folder}/${page}`,
      show: (folder, turn, place) => {
        place.replaceChildren(...wholeReport(`${folder}/${page}`, true));
        return turn.of(Promise.resolve(opened(folder)));
      }});
  }
}

/**
 * A report of the folder, in a sandbox as if from another site, so that its scripts cannot act here.
 * @param {string} path
 * @param {boolean} open
 */
export function wholeReport(path, open) {
  const stamp = state.workspace.stamps[path] ?? '';
  const frame = () => h('iframe', {src: `/files/${path}?${stamp}`, title: `report ${path}`,
    sandbox: 'allow-scripts allow-popups'});
  const details = h('details', {open}, h('summary', {}, 'The whole report'));
  if (open) details.append(frame());
  details.addEventListener('toggle', () => {
    if (details.open && !details.querySelector('iframe')) details.append(frame());
  });
  const link = h('a', {href: `/files/${path}`, target: '_blank', rel: 'noopener'}, `Open ${path} in a new tab`);
  return [h('p', {}, link), details];
}

// ---- data that a report's own page holds --------------------------------------------------------------------------

/** @param {string} path of a report @returns {Promise<Document>} */
const pageOf = async (path) =>
  new DOMParser().parseFromString(await (await fetch(`/files/${path}`)).text(), 'text/html');

/** The folder of a report. @param {string} path */
export const folderOf = (path) => path.replace(/\/?[^/]*$/, '') || '.';

/**
 * Signals over time of a comparison, measured and predicted, with the figure that shows them; null: there are none.
 * @param {string} path of its page
 */
export async function tracksOf(path) {
  const page = await pageOf(path), plot = page.getElementById('tracks'), data = page.getElementById('tracks-data');
  if (!plot || !data) return null;
  return {sets: JSON.parse(data.textContent), figure: JSON.parse(page.getElementById(plot.dataset.tracks).textContent)};
}

/**
 * The runs of a report in 3D: measured, and the model as a ghost. `show` goes to a run and a moment.
 * @param {string} path
 * @param {Turn} turn
 */
export function replayOf(path, turn) {
  const choose = h('select', {'aria-label': 'run in 3D'}), place = h('div', {});
  const node = h('div', {class: 'replays', hidden: true}, h('h3', {}, 'Measured and model in 3D'), choose, place);
  const ready = (async () => {
    const data = (await turn.of(pageOf(path))).getElementById('replay-data');
    if (!data) return null;
    node.hidden = false;
    const recorded = JSON.parse(data.textContent), {runs} = recorded, replay = await replayIn(place, recorded);
    choose.replaceChildren(...runs.map((run, index) => new Option(run.label, index)));
    choose.hidden = runs.length < 2;
    choose.addEventListener('change', () => replay.show(Number(choose.value)));
    return {runs, made: replay};
  })().catch((error) => { place.textContent = error.message; return null; });
  return {
    node,
    /** @param {string} label of the run @param {number | null} time [s] */
    async show(label, time) {
      const loaded = await ready, index = loaded?.runs.findIndex((run) => run.label === label) ?? -1;
      if (index < 0) return;
      choose.value = String(index);
      if (loaded.made.number !== index) loaded.made.show(index);
      if (time !== null) loaded.made.seek(time);
    },
  };
}
