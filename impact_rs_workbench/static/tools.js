// SPDX-License-Identifier: Apache-2.0
// Small tools of the page: nodes, requests, numbers as text, lists of choices, messages.

export const $ = (id) => document.getElementById(id);
export const state = {workspace: null, jobs: [], step: 'predict', chosen: null};

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

export async function ask(path, body, signal) {
  const options = body === undefined ? {signal} :
    {method: 'POST', headers: {'content-type': 'application/json'}, body: JSON.stringify(body), signal};
  const answer = await fetch(path, options);
  const data = answer.headers.get('content-type')?.startsWith('application/json') ?
    await answer.json() : {error: await answer.text()};
  if (!answer.ok) throw new Error(data.error);
  return data;
}

// The questions of one view. `begin` starts a new one and returns its turn. What a turn waits for (an answer, an error, a frame, a
// pause) comes through while it is the newest, and never afterwards: nothing late is painted. What an earlier turn has asked for is aborted.
export class Questions {
  begin() {
    this.flight?.abort();
    const flight = this.flight = new AbortController();
    const of = (promise) => new Promise((done, failed) => {
      const through = (way) => (value) => { if (this.flight === flight) way(value); };
      promise.then(through(done), through(failed));
    });
    const frame = () => of(new Promise(requestAnimationFrame)), pause = (wait) => of(new Promise((over) => setTimeout(over, wait)));
    return {of, frame, pause, ask: (path, body) => of(ask(path, body, flight.signal)), painted: () => frame().then(() => pause(0))};
  }
}

export const query = (values) => new URLSearchParams(values).toString();
const tidy = (text) => text.replace('-', '−');
export const number = (value, digits = 3) => value === null || value === undefined ? '–' : tidy(String(Number(Number(value).toPrecision(digits))));
export const fixed = (value, digits = 3) => value === null ? '–' : tidy((Number(value.toFixed(digits)) + 0).toFixed(digits)); // + 0: no −0.000
export const unit = (text) => !text || text === '-' ? '' : ` ${text}`;
export const slug = (text) => text.replace(/[^A-Za-z0-9]+/g, '_').replace(/^_|_$/g, '');
export const stem = (path) => path.split('/').pop().replace(/\.[a-z]+$/, '');

// A path as it is seen from the folder of the workbench; in the middle of a text, too.
export const inFolder = (text) => state.workspace ? text.replaceAll(`${state.workspace.root}/`, '').replaceAll(state.workspace.root, '.') : text;

export function seconds(value) {
  if (value === null || value === undefined) return '';
  return value < 90 ? `${Math.max(1, Math.round(value))} s left` : `${Math.round(value / 60)} min left`;
}

// Fills a list of choices and keeps what was chosen.
export function fill(select, options, wanted) {
  const before = wanted ?? select.value;
  const content = (all) => JSON.stringify([...all].map((one) => [one.value, one.text]));
  const same = content(select.options) === content(options);
  if (!same) select.replaceChildren(...options.map((one) => new Option(one.text, one.value)));
  if (options.some((one) => one.value === before)) select.value = before;
  fit(select);
}

// A list is as wide as its longest choice needs; where the page is too narrow, what is cut off stands below it.
const pen = document.createElement('canvas').getContext('2d');
const ARROW = 44; // px, of a list beside its text

export function fit(select) {
  const label = select.closest('label');
  if (!label || !select.isConnected) return;
  pen.font = getComputedStyle(select).font;
  const wide = (text) => pen.measureText(text).width + ARROW;
  const longest = Math.max(0, ...[...select.options].map((one) => wide(one.text)));
  label.classList.toggle('long', longest > 170 && longest <= 350);
  label.classList.toggle('wide', longest > 350);
  const text = select.selectedOptions[0]?.text ?? '', cut = select.clientWidth > 0 && wide(text) > select.clientWidth;
  let whole = label.querySelector('small');
  if (!cut) { whole?.remove(); return; }
  if (!whole) label.append(whole = h('small', {class: 'whole'}));
  whole.textContent = text;
}

export function fitAll() { for (const select of document.querySelectorAll('label > select')) fit(select); }
addEventListener('resize', () => requestAnimationFrame(fitAll));
document.addEventListener('change', ({target}) => { if (target.tagName === 'SELECT') fit(target); });

// Replaces changed items only: a button that is replaced while the pointer is down gets no click.
export function refill(node, items) {
  const before = [...node.children];
  items.forEach((item, index) => {
    if (!before[index]) node.append(item); else if (!before[index].isEqualNode(item)) before[index].replaceWith(item);
  });
  for (const item of before.slice(items.length)) item.remove();
}

// Rows of cells, of which the first few columns are texts and the others numbers.
export function table(id, heads, rows, texts = heads.length) {
  const kind = (place) => (place < texts ? 'text' : null);
  return h('div', {class: 'scroll'}, h('table', {id}, h('thead', {}, h('tr', {}, ...heads.map((text, place) => h('th', {scope: 'col', class: kind(place)}, text)))),
    h('tbody', {}, ...rows.map((cells) => h('tr', {}, ...cells.map((text, place) => h('td', {class: kind(place)}, String(text))))))));
}

export const plain = (values) => values.map((value) => ({value, text: value}));

export function labelled(text, control, attributes = {}) {
  return h('label', attributes, h('span', {}, text), control);
}

export function commandLine(text) {
  const copied = h('button', {type: 'button', onclick: async () => {
    await navigator.clipboard.writeText(text);
    copied.textContent = 'copied';
  }}, 'copy');
  return h('div', {class: 'command'}, h('code', {}, text), copied);
}

// The message below a form: the command that it makes, or the error in its input.
export function messageArea() {
  const node = h('div', {class: 'message', 'aria-live': 'polite'});
  return {
    node,
    // The message belongs to an earlier question: it stays in place, so that nothing jumps, and is greyed out.
    wait() { node.setAttribute('aria-busy', 'true'); },
    show(...items) { node.removeAttribute('aria-busy'); node.replaceChildren(...items); },
    command(text) { this.show(commandLine(text)); },
    error(text) { this.show(h('p', {class: 'error', role: 'alert'}, inFolder(text))); },
  };
}

// Arrow keys, Home and End go from tab to tab and open it.
export function arrowKeys(tabs) {
  for (const [place, tab] of tabs.entries()) {
    tab.addEventListener('keydown', (event) => {
      const to = {ArrowRight: place + 1, ArrowLeft: place - 1, Home: 0, End: tabs.length - 1}[event.key];
      if (to === undefined) return;
      event.preventDefault();
      const next = tabs[(to + tabs.length) % tabs.length];
      next.click();
      next.focus();
    });
  }
}

// Tabs of a step, of which one panel is in sight. `parts`: by name the text of the tab and what is in its panel. `changed` is given
// the tab that was chosen; `lead` is the place of the first lines.
export class Tabs {
  constructor(parts, prefix = '') {
    const made = Object.entries(parts);
    this.changed = () => {};
    this.buttons = made.map(([name, [text]]) => h('button', {type: 'button', role: 'tab', id: `tab-${prefix}${name}`,
      'aria-controls': `part-${prefix}${name}`, onclick: () => { this.show(name); this.changed(name); }}, text));
    this.panels = made.map(([name, [, node]]) => h('div', {role: 'tabpanel', id: `part-${prefix}${name}`, 'data-part': name,
      'aria-labelledby': `tab-${prefix}${name}`}, node));
    arrowKeys(this.buttons);
    this.list = h('div', {class: 'tabs', role: 'tablist'}, ...this.buttons);
    this.lead = h('div', {});
    this.show(made[0][0]);
  }

  has(name) { return this.panels.some((panel) => panel.dataset.part === name); }

  show(name) {
    this.chosen = name;
    this.panels.forEach((panel, place) => {
      const own = panel.dataset.part === name;
      panel.hidden = !own;
      this.buttons[place].setAttribute('aria-selected', String(own));
      this.buttons[place].tabIndex = own ? 0 : -1; // the arrow keys lead on from here
    });
  }
}

// A script of the server, once it has run.
export const load = (address) => new Promise((done, failed) => {
  const script = document.createElement('script');
  script.src = address;
  script.onload = done;
  script.onerror = () => failed(new Error(`${address} cannot be loaded`));
  document.head.append(script);
});
