// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Tabs whose command writes a page into a folder of its own: a form, and the pages that are there.

import {hitsForm} from '../forms.js';
import {whenDone} from '../jobs.js';
import {Pages} from '../results.js';
import {h} from '../tools.js';

/** @typedef {import('../types.d.ts').Step} Step */

/** A form of hits, and the pages that its command has written. @implements {Step} */
export class PagePart {
  /**
   * @param {string} command
   * @param {object} texts
   * @param {string} texts.run label of the button
   * @param {string} texts.label of the list of pages
   * @param {string} texts.page its file in the folder
   * @param {(part: PagePart) => string} texts.output folder of the next page
   * @param {(folder: string) => void | Promise<void>} texts.opened is given the folder of the page that is shown
   */
  constructor(command, {run, label, page, output, opened}) {
    this.command = command;
    this.run = run;
    this.pages = new Pages(command, label, page, opened);
    this.output = output;
  }

  build() {
    this.form = hitsForm(this.command, this.run, {output: () => this.output(this)});
    whenDone(this.command, ([folder]) => { this.pages.wanted = folder; });
    return h('div', {}, this.form.node, ...this.pages.nodes);
  }

  /** Name of the scenario in the form. */
  scenario() { return this.form.value('scenario') ?? 'push'; }

  update() { this.form.update(); this.pages.update(); }
}
