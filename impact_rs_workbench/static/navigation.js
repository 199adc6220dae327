// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Steps of the page and their tabs: which one is in sight, and its address.

import {leads, showAbout, termsOf} from './about.js';
import {ABOUT} from './explain.js';
import {$, button, fitAll, h, state, Tabs} from './tools.js';

/** @typedef {import('./types.d.ts').Step} Step */

/** @type {Record<string, {part: Step, panel: HTMLElement}>} */
const steps = {};

/** A step of several tabs; only the tab in sight asks the server for anything. @implements {Step} */
export class Tabbed {
  /** @param {string} title @param {Record<string, [string, Step]>} parts by name, text and content of a tab */
  constructor(title, parts, prefix = '') {
    this.title = title;
    this.parts = parts;
    this.prefix = prefix;
  }

  build() {
    const built = Object.entries(this.parts).map(([name, [text, part]]) => [name, [text, part.build()]]);
    this.tabs = new Tabs(Object.fromEntries(built), this.prefix);
    return h('section', {}, h('h2', {}, this.title), this.tabs.list, this.tabs.lead, ...this.tabs.panels);
  }

  update() { this.parts[this.tabs.chosen][1].update(); }

  sightChanged() { for (const [, part] of Object.values(this.parts)) part.sightChanged?.(); }
}

/** @param {string} name @param {string} text of its button @param {Step} part */
export function addStep(name, text, part) {
  const panel = part.build();
  steps[name] = {part, panel};
  $('steps').append(h('li', {}, button(text, () => go(name), {'data-step': name})));
  if (part.tabs) part.tabs.changed = (tab) => go(name, tab); else panel.firstChild.after(leads[name]);
  $('middle').append(panel);
}

/** Whether a step, or a tab of it, is in sight. @param {string} step @param {string} [tab] */
export const inSight = (step, tab) => state.step === step && (!tab || steps[step]?.part.tabs?.chosen === tab);

/** The step in sight shows the folder as it is now. */
export function refresh() { steps[state.step].part.update(); }

/** Opens a step, and a tab of it; without one the tab that was open before. @param {string} step */
export function go(step, tab = '') {
  const {part} = steps[step], {tabs} = part;
  state.step = step;
  if (tabs && tab && tabs.chosen !== tab) tabs.show(tab);
  const key = tabs ? `${step}/${tabs.chosen}` : step, tabAbout = ABOUT[tabs?.chosen];
  // The address of the step alone is replaced, so that a step back in the history leaves it.
  if (location.hash === `#${step}`) history.replaceState(null, '', `#${key}`); else location.hash = key;
  tabs?.lead.replaceChildren(leads[key]);
  for (const [name, {panel}] of Object.entries(steps)) panel.hidden = name !== step;
  for (const item of /** @type {NodeListOf<HTMLElement>} */ ($('steps').querySelectorAll('button'))) {
    if (item.dataset.step === step) item.setAttribute('aria-current', 'step');
    else item.removeAttribute('aria-current');
  }
  showAbout({...(tabAbout ?? ABOUT[step]), terms: tabAbout ? [] : termsOf(step)});
  for (const item of Object.values(steps)) item.part.sightChanged?.();
  if (state.workspace) part.update();
  requestAnimationFrame(fitAll);
}

/**
 * The step and the tab of an address; null if there are no such.
 * @param {string} hash
 * @returns {[string, string] | null}
 */
function stepOf(hash) {
  const [step, tab] = hash.slice(1).split('/'), tabs = steps[step]?.part.tabs;
  return steps[step] ? [step, tabs && tab && tabs.has(tab) ? tab : ''] : null;
}

/** Opens the step of the address, now and whenever the address changes. */
export function followAddress() {
  const [first, tab] = stepOf(location.hash) ?? ['predict', ''];
  go(first, tab);
  addEventListener('hashchange', () => {
    const [step, part] = stepOf(location.hash) ?? [];
    if (step && !inSight(step, part)) go(step, part);
  });
}
