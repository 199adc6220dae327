// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Explanations: the first two lines of a step, the right column, and the manual.

import {LEADS, TERMS, TERMS_OF} from './explain.js';
import {$, h, LatestRequest, note} from './tools.js';

// ---- the first two lines of a step, or of a tab -------------------------------------------------------------------

const statusTexts = Object.fromEntries(Object.entries(LEADS)
  .map(([key, {empty}]) => [key, h('span', {'data-says': key}, empty)]));

/** What a step is; what it says, and what comes next. @param {string} key of LEADS */
function lead(key) {
  const {what, next, to} = LEADS[key];
  const link = h('a', {href: `#${to}`}, next);
  return h('div', {class: 'lead'}, h('p', {}, what), h('p', {}, statusTexts[key], ' Next: ', link, '.'));
}

export const leads = Object.fromEntries(Object.keys(LEADS).map((key) => [key, lead(key)]));

/** What a step or tab says; without a text what it says at first. @param {string} key @param {string} [text] */
export function says(key, text) { statusTexts[key].textContent = text || LEADS[key].empty; }

// ---- the right column ---------------------------------------------------------------------------------------------

/** @param {string} markup */
function drawing(markup) {
  const template = document.createElement('template');
  template.innerHTML = markup;
  return template.content;
}

/** @param {string} step */
export const termsOf = (step) => TERMS_OF[step].map((key) => h('figure', {class: 'term'}, drawing(TERMS[key].svg),
  h('figcaption', {}, h('b', {}, TERMS[key].name), `: ${TERMS[key].text}`)));

/** @param {import('./explain.js').About} about */
export function showAbout({title, text, equation, units, page, command, facts = [], actions = [], terms = []}) {
  const open = (event) => { event.preventDefault(); openManual(page); };
  $('right').replaceChildren(
    h('h2', {}, title), text ? h('p', {}, text) : '',
    equation ? h('p', {}, ...equation.split('\n').flatMap((line) => [h('code', {}, line), h('br')])) : '',
    units ? note(`Units: ${units}`) : '',
    ...facts.map((fact) => h('p', {}, fact)),
    command ? h('p', {class: 'note'}, 'In a terminal: ', h('code', {}, command)) : '',
    actions.length ? h('div', {class: 'actions'}, ...actions) : '',
    page ? h('p', {}, h('a', {href: `#manual/${page}`, onclick: open}, 'In the manual')) : '', ...terms,
  );
}

// ---- the manual ---------------------------------------------------------------------------------------------------

const requests = new LatestRequest();

/** @param {string} name of a page, with an anchor or without */
async function openManual(name) {
  const [page, anchor] = name.split('#'), article = $('manual-page');
  const dialog = /** @type {HTMLDialogElement} */ ($('manual'));
  try {
    const {html} = await requests.begin().ask(`/manual/${page}`);
    article.innerHTML = html;
    for (const image of article.querySelectorAll('img')) image.src = `/manual/${image.getAttribute('src')}`;
    for (const link of article.querySelectorAll('a[href]')) {
      const target = link.getAttribute('href');
      if (/^[a-z_]+\.md/.test(target)) {
        link.addEventListener('click', (event) => { event.preventDefault(); openManual(target); });
      } else if (!target.startsWith('http')) link.removeAttribute('href');
    }
    if (!dialog.open) dialog.showModal();
    dialog.scrollTop = 0;
    if (anchor) document.getElementById(anchor)?.scrollIntoView();
  } catch (error) { showAbout({title: 'Manual', text: error.message}); }
}
