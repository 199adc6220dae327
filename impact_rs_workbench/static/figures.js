// SPDX-License-Identifier: Apache-2.0
// Figures of the reports in the colours and widths of the page.

import {h, load, Questions} from './tools.js';

let loading = null;

// The library, when the first figure is drawn: numbers do not wait for it.
const plotly = () => loading ??= load('/static/plotly.js');

export const darkScheme = matchMedia('(prefers-color-scheme: dark)');
const IN_THE_DARK = {'#0072b2': '#56b4e9', '#d55e00': '#ff9142', '#009e73': '#2fcf9f', '#000000': '#f0f0f0',
  '#555555': '#b0b8bd', '#1a1a1a': '#eceff1', '#777777': '#b0b8bd'};

export function seen(colour) {
  return darkScheme.matches && typeof colour === 'string' ? IN_THE_DARK[colour.toLowerCase()] ?? colour : colour;
}

// A figure follows the width of its place and keeps its height: Plotly's own `responsive` forgets the height that a
// figure asks for, and what stands below it is covered.
const widths = new ResizeObserver((seen_) => {
  for (const {target: node, contentRect: {width}} of seen_) {
    if (!node.data || width <= 0 || Math.abs(width - node.layout.width) < 1) continue;
    if (node.redrawn) node.redrawn(); else Plotly.relayout(node, {width}); // what else changes with the width
  }
});

const questions = new WeakMap(); // of every place of a figure

function begin(node) {
  if (!questions.has(node)) questions.set(node, new Questions());
  return questions.get(node).begin();
}

// An empty place: nor does a figure come that still waits for the library.
export function erase(node) {
  begin(node);
  if (node.data) Plotly.purge(node);
  node.replaceChildren();
}

// A figure of the reports in the colours of this page; of several for one place, the newest.
export async function draw(node, figure, config = {}) {
  const turn = begin(node);
  await turn.of(plotly());
  const style = getComputedStyle(document.documentElement);
  const ink = style.getPropertyValue('--ink').trim(), grid = style.getPropertyValue('--grid').trim();
  const data = figure.data.map((trace) => ({
    ...trace,
    ...(trace.line ? {line: {...trace.line, color: seen(trace.line.color)}} : {}),
    ...(trace.marker && typeof trace.marker.color === 'string' ?
      {marker: {...trace.marker, color: seen(trace.marker.color)}} : {}),
  }));
  const axes = Object.fromEntries(['xaxis', 'yaxis', 'xaxis2', 'yaxis2'].filter((name) => figure.layout[name] || !name.endsWith('2'))
    .map((name) => [name, {...figure.layout[name], gridcolor: grid, zerolinecolor: grid, color: ink}]));
  const layout = {...figure.layout, ...axes, paper_bgcolor: 'rgba(0,0,0,0)', plot_bgcolor: 'rgba(0,0,0,0)', autosize: false,
    width: node.clientWidth || 600, height: figure.layout.height ?? 450, // hidden, it has no width yet
    font: {...figure.layout.font, color: ink, family: 'system-ui, sans-serif'}};
  widths.observe(node);
  return turn.of(Plotly.react(node, data, layout, {displaylogo: false, displayModeBar: false, ...config}));
}

// A line at the time that the replay shows.
export function cursor(node, time) {
  if (!node._fullLayout) return;
  let line = node.querySelector('.cursor');
  if (!line) node.append(line = h('div', {class: 'cursor'}));
  const axis = node._fullLayout.xaxis, size = node._fullLayout._size, place = axis.d2p(time);
  line.hidden = !(place >= 0 && place <= axis._length);
  Object.assign(line.style, {left: `${axis._offset + place - 1}px`, top: `${size.t}px`, height: `${size.h}px`});
}
