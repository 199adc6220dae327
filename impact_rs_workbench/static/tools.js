// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Small tools of the page: nodes, requests, numbers as text, lists of choices, messages.

/** @typedef {import('./types.d.ts').Option} Choice */

/** The element with an identifier. @param {string} id */
export const $ = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

/**
 * What all steps share: the folder as the server sees it, its jobs, the step in sight and the chosen entry on the left.
 * @type {{workspace: import('./types.d.ts').Workspace, jobs: import('./types.d.ts').Job[], step: string,
 *   chosen: string | null}}
 */
export const state = {workspace: null, jobs: [], step: 'predict', chosen: null};

/**
 * A new element; attributes that begin with "on" are listeners, empty children are left out.
 * @template {keyof HTMLElementTagNameMap} Tag
 * @param {Tag} tag
 * @param {Record<string, any>} [attributes]
 * @param {...any} children
 * @returns {HTMLElementTagNameMap[Tag]}
 */
export function h(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith('on')) node.addEventListener(name.slice(2), value);
    else if (value === true) node.setAttribute(name, '');
    else if (value !== false && value !== null && value !== undefined) node.setAttribute(name, value);
  }
  node.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== ''));
  return node;
}

/**
 * The server's answer to a GET, or with a body to a POST.
 * @param {string} path
 * @param {any} [body] sent as JSON
 * @param {RequestInit} [options]
 * @returns {Promise<any>}
 * @throws {Error} with the server's own sentence
 */
export async function ask(path, body, options = {}) {
  const post = {method: 'POST', headers: {'content-type': 'application/json'}, body: JSON.stringify(body)};
  const answer = await fetch(path, body === undefined ? options : {...post, ...options});
  const data = answer.headers.get('content-type')?.startsWith('application/json') ?
    await answer.json() : {error: await answer.text()};
  if (!answer.ok) throw new Error(data.error);
  return data;
}

/** @typedef {ReturnType<LatestRequest['begin']>} Turn */

/**
 * The requests of one view: only the newest one is answered. `begin` starts a request and returns its turn. A turn's
 * promises (an answer, an error, a frame, a pause) settle only while it is the newest, so that no late answer is
 * painted. Fetches of an earlier turn are aborted.
 */
export class LatestRequest {
  /** @type {AbortController | undefined} */
  flight;

  begin() {
    this.flight?.abort();
    const flight = this.flight = new AbortController();
    /** @template T @param {Promise<T>} promise @returns {Promise<T>} */
    const of = (promise) => new Promise((done, failed) => {
      const through = (way) => (value) => { if (this.flight === flight) way(value); };
      promise.then(through(done), through(failed));
    });
    const frame = () => of(new Promise(requestAnimationFrame));
    /** @param {number} wait milliseconds */
    const pause = (wait) => of(new Promise((over) => setTimeout(over, wait)));
    return {
      of, frame, pause,
      /** @param {string} path @param {any} [body] */
      ask: (path, body) => of(ask(path, body, {signal: flight.signal})),
      painted: () => frame().then(() => pause(0)),
    };
  }
}

/** @param {Record<string, string>} values */
export const query = (values) => new URLSearchParams(values).toString();

// ---- text ---------------------------------------------------------------------------------------------------------

const MINUS = '−';

/** A number with significant digits; a dash where there is none. @param {number | null} [value] */
export const number = (value, digits = 3) => value === null || value === undefined ? '–' :
  String(Number(Number(value).toPrecision(digits))).replace('-', MINUS);

/** A number with decimals; a dash where there is none. @param {number | null} value */
export const fixed = (value, digits = 3) => value === null ? '–' :
  (Number(value.toFixed(digits)) + 0).toFixed(digits).replace('-', MINUS); // + 0: no −0.000

/** @param {number} amount */
export const count = (amount, singular, plural = `${singular}s`) => `${amount} ${amount === 1 ? singular : plural}`;

/** A unit behind a number; nothing for a dimensionless one. @param {string} [text] */
export const unit = (text) => !text || text === '-' ? '' : ` ${text}`;

/** A name with its unit in brackets. @param {string} name @param {string} [of] */
export const withUnit = (name, of) => unit(of) ? `${name} [${of}]` : name;

/** @param {{low: number | null, high: number | null}} interval */
export const interval = ({low, high}, text = number) => low === null ? '–' : `${text(low)} … ${text(high)}`;

/** A text as a part of a file name. @param {string} text */
export const slug = (text) => text.replace(/[^A-Za-z0-9]+/g, '_').replace(/^_|_$/g, '');

/** The name of a file without folder and suffix. @param {string} path */
export const stem = (path) => path.split('/').pop().replace(/\.[a-z]+$/, '');

/** A text whose paths are relative to the folder of the workbench. @param {string} text */
export const inFolder = (text) => !state.workspace ? text :
  text.replaceAll(`${state.workspace.root}/`, '').replaceAll(state.workspace.root, '.');

/** @param {number | null} [value] seconds */
export function seconds(value) {
  if (value === null || value === undefined) return '';
  return value < 90 ? `${Math.max(1, Math.round(value))} s left` : `${Math.round(value / 60)} min left`;
}

// ---- lists of choices ---------------------------------------------------------------------------------------------

/** Choices whose text is their value. @param {string[]} values @returns {Choice[]} */
export const plain = (values) => values.map((value) => ({value, text: value}));

/**
 * Fills a list of choices and keeps what was chosen.
 * @param {HTMLSelectElement} select
 * @param {Choice[]} choices
 * @param {string} [wanted] chosen instead, if it is among them
 */
export function fill(select, choices, wanted) {
  const before = wanted ?? select.value;
  const content = (all) => JSON.stringify([...all].map((entry) => [entry.value, entry.text]));
  const same = content(select.options) === content(choices);
  if (!same) select.replaceChildren(...choices.map((choice) => new Option(choice.text, choice.value)));
  if (choices.some((choice) => choice.value === before)) select.value = before;
  fit(select);
}

const pen = document.createElement('canvas').getContext('2d');
const ARROW = 44; // px, of a list beside its text
const ONE_COLUMN = 170; // px of text that fit into one column of a form
const TWO_COLUMNS = 350; // px of text that fit into two

/**
 * Makes a list as wide as its longest choice needs; below a list that is too narrow, the whole choice stands as text.
 * @param {HTMLSelectElement} select
 */
export function fit(select) {
  const label = select.closest('label');
  if (!label || !select.isConnected) return;
  pen.font = getComputedStyle(select).font;
  const wide = (text) => pen.measureText(text).width + ARROW;
  const longest = Math.max(0, ...[...select.options].map((option) => wide(option.text)));
  label.classList.toggle('long', longest > ONE_COLUMN && longest <= TWO_COLUMNS);
  label.classList.toggle('wide', longest > TWO_COLUMNS);
  const text = select.selectedOptions[0]?.text ?? '', cut = select.clientWidth > 0 && wide(text) > select.clientWidth;
  let whole = label.querySelector('small');
  if (!cut) { whole?.remove(); return; }
  if (!whole) label.append(whole = h('small', {class: 'whole'}));
  whole.textContent = text;
}

export function fitAll() {
  for (const select of /** @type {NodeListOf<HTMLSelectElement>} */ (document.querySelectorAll('label > select'))) {
    fit(select);
  }
}
addEventListener('resize', () => requestAnimationFrame(fitAll));
document.addEventListener('change', ({target}) => { if (target instanceof HTMLSelectElement) fit(target); });

// ---- parts of a page ----------------------------------------------------------------------------------------------

/**
 * Replaces changed items only: a button that is replaced while the pointer is down gets no click.
 * @param {Element} node
 * @param {Element[]} items
 */
export function refill(node, items) {
  const before = [...node.children];
  items.forEach((item, index) => {
    if (!before[index]) node.append(item); else if (!before[index].isEqualNode(item)) before[index].replaceWith(item);
  });
  for (const item of before.slice(items.length)) item.remove();
}

/**
 * A table that scrolls sideways where it is too wide. The first columns are texts, the others numbers.
 * @param {Record<string, any>} attributes
 * @param {string[]} heads
 * @param {HTMLTableRowElement[] | any[][]} rows or their cells
 * @param {number} [texts] how many columns are texts
 */
export function table(attributes, heads, rows, texts = heads.length) {
  const kind = (column) => (column < texts ? 'text' : null);
  const row = (cells) => cells instanceof HTMLTableRowElement ? cells :
    h('tr', {}, ...cells.map((cell, column) =>
      h('td', {class: kind(column)}, cell instanceof Node ? cell : String(cell))));
  return h('div', {class: 'scroll'}, h('table', attributes,
    h('thead', {}, h('tr', {}, ...heads.map((text, column) => h('th', {scope: 'col', class: kind(column)}, text)))),
    h('tbody', {}, ...rows.map(row))));
}

/** A control with its label above it. @param {string} text @param {Element} control */
export function labelled(text, control, attributes = {}) {
  return h('label', attributes, h('span', {}, text), control);
}

/** @param {string} text @param {(event: MouseEvent) => void} act */
export const button = (text, act, attributes = {}) => h('button', {type: 'button', ...attributes, onclick: act}, text);

/** @param {string | Node} text */
export const note = (text, attributes = {}) => h('p', {class: 'note', ...attributes}, text);

/** What went wrong, in one line. @param {Error} error */
export const mistake = (error) => h('p', {class: 'error', role: 'alert'}, inFolder(error.message));

/** A command for a terminal, with a button that copies it. @param {string} text */
export function commandLine(text) {
  const copied = button('copy', async () => {
    await navigator.clipboard.writeText(text);
    copied.textContent = 'copied';
  });
  return h('div', {class: 'command'}, h('code', {}, text), copied);
}

/** @typedef {ReturnType<typeof messageArea>} MessageArea */

/** The message below a form: the command that it makes, or the error in its input. */
export function messageArea() {
  const node = h('div', {class: 'message', 'aria-live': 'polite'});
  return {
    node,
    /** The message belongs to an earlier question: it keeps its space, so that nothing jumps, and is hidden. */
    wait() { node.setAttribute('aria-busy', 'true'); },
    /** @param {...(string | Node)} items */
    show(...items) { node.removeAttribute('aria-busy'); node.replaceChildren(...items); },
    /** @param {string} text */
    command(text) { this.show(commandLine(text)); },
    /** @param {Error} error */
    error(error) { this.show(mistake(error)); },
  };
}

/** Arrow keys, Home and End go from tab to tab and open it. @param {HTMLButtonElement[]} tabs */
function arrowKeys(tabs) {
  for (const [index, tab] of tabs.entries()) {
    tab.addEventListener('keydown', (event) => {
      const to = {ArrowRight: index + 1, ArrowLeft: index - 1, Home: 0, End: tabs.length - 1}[event.key];
      if (to === undefined) return;
      event.preventDefault();
      const next = tabs[(to + tabs.length) % tabs.length];
      next.click();
      next.focus();
    });
  }
}

/** Tabs of a step, of which one panel is in sight. */
export class Tabs {
  /**
   * @param {Record<string, [string, Node]>} parts by name, the text of the tab and the content of its panel
   * @param {string} [prefix] of identifiers
   */
  constructor(parts, prefix = '') {
    const entries = Object.entries(parts);
    /** @type {(name: string) => void} */
    this.changed = () => {};
    this.buttons = entries.map(([name, [text]]) => button(text, () => { this.show(name); this.changed(name); },
      {role: 'tab', id: `tab-${prefix}${name}`, 'aria-controls': `part-${prefix}${name}`}));
    this.panels = entries.map(([name, [, node]]) => h('div', {role: 'tabpanel', id: `part-${prefix}${name}`,
      'data-part': name, 'aria-labelledby': `tab-${prefix}${name}`}, node));
    arrowKeys(this.buttons);
    this.list = h('div', {class: 'tabs', role: 'tablist'}, ...this.buttons);
    this.lead = h('div', {}); // place of the first two lines
    this.show(entries[0][0]);
  }

  /** @param {string} name */
  has(name) { return this.panels.some((panel) => panel.dataset.part === name); }

  /** @param {string} name */
  show(name) {
    this.chosen = name;
    this.panels.forEach((panel, index) => {
      const isShown = panel.dataset.part === name;
      panel.hidden = !isShown;
      this.buttons[index].setAttribute('aria-selected', String(isShown));
      this.buttons[index].tabIndex = isShown ? 0 : -1; // the arrow keys lead on from here
    });
  }
}

/** A script of the server, once it has run. @param {string} address @returns {Promise<void>} */
export const load = (address) => new Promise((done, failed) => {
  const script = document.createElement('script');
  script.src = address;
  script.onload = () => done();
  script.onerror = () => failed(new Error(`${address} cannot be loaded`));
  document.head.append(script);
});
