// SPDX-License-Identifier: Apache-2.0
// @ts-check
// The truth of a practice campaign, and what its diagnosis found.

import {reading} from '../results.js';
import {ask, commandLine, h, interval, mistake, number, query, table, withUnit} from '../tools.js';

/** A row of a parameter: hidden and estimated. */
function comparison({name, unit, hidden, estimate, low, high}) {
  const inside = low === null ? '–' : low <= hidden && hidden <= high ? '✓' : '✗';
  return [withUnit(name, unit), number(hidden), number(estimate), interval({low, high}), inside];
}

/** @param {string} path the campaign, or its diagnosis @param {Element} node place of the answer */
export async function reveal(path, node) {
  node.replaceChildren(reading(path));
  try {
    const {correct, truth, named, parameters, command} = await ask(`/api/reveal?${query({path})}`);
    const list = (names) => names.join(' + ') || 'nothing';
    node.replaceChildren(h('div', {class: 'answer', 'data-correct': String(correct)},
      h('b', {class: correct ? 'good' : 'error'}, correct ? '✓ right' : '✗ wrong'),
      `Hidden: ${list(truth)}. Named: ${list(named)}.`,
      parameters.length ? table({}, ['parameter', 'hidden', 'estimate', '95 % interval', 'inside'],
        parameters.map(comparison), 1) : ''),
    commandLine(command));
  } catch (error) { node.replaceChildren(mistake(error)); }
}
