// SPDX-License-Identifier: Apache-2.0
// What a node identify has published: changes of the cell, the parameters believed, and what the next hit will measure.

import {commandLine, fixed, h, refill, table, unit} from './tools.js';

// An estimate and its interval, as two cells, with two significant digits of the width of the interval.
function estimated(value, [low, high], of) {
  const places = Math.min(12, Math.max(0, 1 - Math.floor(Math.log10(high - low || 1))));
  return [`${fixed(value, places)}${unit(of)}`, `${fixed(low, places)} to ${fixed(high, places)}${unit(of)}`];
}

// Replaces what has changed only, so that an opened table stays open.
export function showFollowed(node, {prediction, changes, diagnosis, refused, unreadable}) {
  const items = [];
  const open = node.querySelector('details')?.open;
  if (changes.length) items.push(h('div', {class: 'changes'}, h('strong', {}, 'The cell has changed'), ...changes.map((one) => h('p', {}, one.words)), commandLine(changes[0].diagnose)));
  if (diagnosis) items.push(h('p', {}, `Full diagnosis: ${diagnosis.words}`));
  if (prediction?.followed.length) items.push(h('div', {}, h('p', {}, h('strong', {}, 'Believed after the last hit')),
    table('believed', ['parameter', 'estimate', '95 % interval'], prediction.followed.map((one) => [one.parameter, ...estimated(one.estimate, one.ci95, one.unit)]), 1)));
  if (prediction) items.push(h('details', {open: open ?? false}, h('summary', {}, `Prediction of the next hit, if it starts as ${prediction.like} did`),
    table('next-hit', ['what', 'predicted', '95 % interval'], prediction.values.map((one) => [[one.signal, one.index, `(${one.phase}${one.bin ? ` ${one.bin}` : ''})`].join(' '),
      ...estimated(one.value, one.ci95, one.unit)]), 1)));
  if (refused) items.push(h('p', {class: 'note'}, `No hit: ${refused.hit ? `${refused.hit}: ` : ''}${refused.reason}`));
  for (const text of unreadable) items.push(h('p', {class: 'error'}, text));
  if (items.length) items.unshift(h('h3', {}, 'Followed hits'));
  refill(node, items);
}
