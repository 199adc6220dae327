// SPDX-License-Identifier: Apache-2.0
// @ts-check
// Figures of the reports in the colours and widths of the page.

import {h, LatestRequest, load} from './tools.js';

/** @typedef {import('./types.d.ts').Plot} Plot */
/** @typedef {import('./types.d.ts').Figure} Figure */

let loading = null;

// The library, when the first figure is drawn: numbers do not wait for it.
const plotly = () => loading ??= load('/static/plotly.js');

export const darkScheme = matchMedia('(prefers-color-scheme: dark)');
const style = getComputedStyle(document.documentElement);

/** Colours of curves (Okabe and Ito 2008, then four more): palette.css has what they are on a dark page. */
const COLOURS = ['#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9', '#555555', '#7A5195', '#003F5C',
  '#BC5090'];

/** @param {number} index of a curve */
export const colourOf = (index) => COLOURS[index % COLOURS.length];

/** A colour of a figure as the page shows it, light or dark: palette.css. @param {any} colour */
export function themed(colour) {
  if (typeof colour !== 'string' || colour[0] !== '#') return colour;
  return style.getPropertyValue(`--figure-${colour.slice(1).toLowerCase()}`).trim() || colour;
}

const COLOURED = ['line', 'marker', 'error_y']; // parts of a trace

// All colours in a part of a figure.
function lit(part) {
  if (Array.isArray(part)) return part.map(lit);
  if (part?.constructor !== Object) return themed(part);
  return Object.fromEntries(Object.entries(part).map(([name, value]) => [name, lit(value)]));
}

/** Numbers of a report, as its own script reads them. @param {string} text base64 of float32 */
export function floats(text) {
  return new Float32Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
}

/** The place of a figure. @param {string} name for those who do not see it @returns {Plot} */
export const plotPlace = (name, attributes = {}) =>
  h('div', {class: 'plot', role: 'img', 'aria-label': name, ...attributes});

const LEGEND_ROW = 19; // px
const LEGEND_COLUMN = 190; // px

/** Height of a legend below a figure [px]. @param {Plot} node @param {number} entries */
export const legendHeight = (node, entries, least = 0) =>
  LEGEND_ROW * Math.ceil(entries / Math.max(1, Math.floor((node.clientWidth - least) / LEGEND_COLUMN)));

/** Layout of a legend at the lower edge. */
export const LEGEND_BELOW = {orientation: 'h', xref: 'container', x: 0, xanchor: 'left', yref: 'container', y: 0,
  yanchor: 'bottom'};

// A figure follows the width of its place and keeps its height. Plotly's own `responsive` forgets the height that a
// figure asks for, and covers what stands below it.
const widths = new ResizeObserver((changes) => {
  for (const {target, contentRect: {width}} of changes) {
    const node = /** @type {Plot} */ (target);
    if (!node.data || width <= 0 || Math.abs(width - node.layout.width) < 1) continue;
    if (node.redrawn) node.redrawn(); else Plotly.relayout(node, {width});
  }
});

/** @type {WeakMap<Plot, LatestRequest>} of every place of a figure */
const requests = new WeakMap();

/** @param {Plot} node */
function begin(node) {
  if (!requests.has(node)) requests.set(node, new LatestRequest());
  return requests.get(node).begin();
}

/** Empties a place; a figure that still waits for the library does not come either. @param {Plot} node */
export function erase(node) {
  begin(node);
  if (node.data) Plotly.purge(node);
  node.replaceChildren();
}

/**
 * A figure in the colours of this page; of several for one place, the newest.
 * @param {Plot} node
 * @param {Figure} figure
 * @param {any} [config] of Plotly
 */
export async function draw(node, figure, config = {}) {
  const turn = begin(node);
  await turn.of(plotly());
  const ink = style.getPropertyValue('--ink').trim(), grid = style.getPropertyValue('--grid').trim();
  const data = figure.data.map((trace) => ({...trace, ...Object.fromEntries(COLOURED.filter((part) => trace[part])
    .map((part) => [part, lit(trace[part])]))}));
  const themedLayout = lit(figure.layout), axis = {gridcolor: grid, zerolinecolor: grid, color: ink};
  const named = ['xaxis', 'yaxis', 'xaxis2', 'yaxis2'].filter((name) => themedLayout[name] || !name.endsWith('2'));
  const axes = Object.fromEntries(named.map((name) => [name, {...themedLayout[name], ...axis}]));
  const layout = {...themedLayout, ...axes, paper_bgcolor: 'rgba(0,0,0,0)', plot_bgcolor: 'rgba(0,0,0,0)',
    autosize: false, width: node.clientWidth || 600, height: themedLayout.height ?? 450, // hidden, it has no width yet
    font: {...themedLayout.font, color: ink, family: 'system-ui, sans-serif'}};
  widths.observe(node);
  return turn.of(Plotly.react(node, data, layout, {displaylogo: false, displayModeBar: false, ...config}));
}

/**
 * Curves over each other, each with an entry of the legend in a row of its own.
 * @param {Plot} node
 * @param {any[]} data traces
 * @param {string} x title of the axis
 * @param {string} y
 */
export const drawOverlay = (node, data, x, y) => draw(node, {data, layout: {height: 380 + 18 * data.length,
  margin: {l: 60, r: 12, t: 10, b: 60 + 18 * data.length}, showlegend: true, xaxis: {title: {text: x}},
  yaxis: {title: {text: y}, automargin: true}, legend: {...LEGEND_BELOW, entrywidth: 1, entrywidthmode: 'fraction'}}},
{displayModeBar: 'hover'});

/** A line at the time that the replay shows. @param {Plot} node @param {number} time */
export function cursor(node, time) {
  if (!node._fullLayout) return;
  let line = /** @type {HTMLElement | null} */ (node.querySelector('.cursor'));
  if (!line) node.append(line = h('div', {class: 'cursor'}));
  const axis = node._fullLayout.xaxis, size = node._fullLayout._size, left = axis.d2p(time);
  line.hidden = !(left >= 0 && left <= axis._length);
  Object.assign(line.style, {left: `${axis._offset + left - 1}px`, top: `${size.t}px`, height: `${size.h}px`});
}
