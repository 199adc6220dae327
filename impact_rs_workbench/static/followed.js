// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Messages of a node identify: changes of the cell, estimates of the parameters, and the prediction of the next hit.

import {commandLine, fixed, h, mistake, note, refill, table, unit} from './tools.js';

/** An estimate and its interval as two cells, with two significant digits of the width of the interval. */
function estimated(value, [low, high], of) {
  const decimals = Math.min(12, Math.max(0, 1 - Math.floor(Math.log10(high - low || 1))));
  return [`${fixed(value, decimals)}${unit(of)}`, `${fixed(low, decimals)} to ${fixed(high, decimals)}${unit(of)}`];
}

const predictedRow = ({signal, index, phase, bin, value, ci95, unit: of}) =>
  [[signal, index, `(${phase}${bin ? ` ${bin}` : ''})`].join(' '), ...estimated(value, ci95, of)];

/** Replaces only what has changed, so that an opened table stays open. @param {Element} node */
export function showFollowed(node, {prediction, changes, diagnosis, refused, unreadable}) {
  const items = [], open = node.querySelector('details')?.open ?? false;
  if (changes.length) {
    items.push(h('div', {class: 'changes'}, h('strong', {}, 'The cell has changed'),
      ...changes.map((change) => h('p', {}, change.words)), commandLine(changes[0].diagnose)));
  }
  if (diagnosis) items.push(h('p', {}, `Full diagnosis: ${diagnosis.words}`));
  if (prediction?.followed.length) {
    items.push(h('div', {}, h('p', {}, h('strong', {}, 'Estimates after the last hit')),
      table({id: 'believed'}, ['parameter', 'estimate', '95 % interval'],
        prediction.followed.map(({parameter, estimate, ci95, unit: of}) =>
          [parameter, ...estimated(estimate, ci95, of)]), 1)));
  }
  if (prediction) {
    items.push(h('details', {open}, h('summary', {},
      `Prediction of the next hit, if it starts like ${prediction.like}`),
      table({id: 'next-hit'}, ['signal', 'prediction', '95 % interval'], prediction.values.map(predictedRow), 1)));
  }
  if (refused) items.push(note(`No hit: ${refused.hit ? `${refused.hit}: ` : ''}${refused.reason}`));
  for (const text of unreadable) items.push(mistake(new Error(text)));
  if (items.length) items.unshift(h('h3', {}, 'Followed hits'));
  refill(node, items);
}
