// SPDX-License-Identifier: Apache-2.0
// For a reader who has not read the paper: the first two lines of every step, and the terms with a sketch.

// By step: what it is, what it says before there is anything, and the step that comes next.
export const LEADS = {
  predict: {what: 'The velocities of robot and object just after an impact, computed before it happens.', empty: 'Computing …',
    next: 'test it on trials', step: 'measure'},
  measure: {what: 'Trials: the robot hits the object, and every signal is recorded.', empty: 'Nothing is recorded yet.',
    next: 'hold them against the model', step: 'compare'},
  compare: {what: 'The model against the measurements: how far it is off, and where.', empty: 'Nothing is compared yet.',
    next: 'find out why', step: 'diagnose'},
  diagnose: {what: 'The physical effect that the model lacks, judged on data that the search has not seen.',
    empty: 'Nothing is diagnosed yet.', next: 'add the effect to the model', step: 'add'},
  add: {what: 'A better model: the parent model with the effects that were found.', empty: 'There is the nominal model alone.',
    next: 'see whether the error falls', step: 'history'},
  history: {what: 'The error from model to model: it falls where an effect was missing.', empty: 'No history yet.',
    next: 'see estimates and runs over each other', step: 'overlay'},
  overlay: {what: 'Runs over each other, and the estimate of a parameter from diagnosis to diagnosis.',
    empty: 'Nothing is recorded yet.', next: 'let the loop run by itself', step: 'investigate'},
  investigate: {what: 'The whole loop by itself: trials, comparison, diagnosis and better model, round after round.',
    empty: 'Nothing is investigated yet.', next: 'predict with what was found', step: 'predict'},
};

// Sketches are 220 x 92; colours are those of the page.
const sketch = (body) => `<svg viewBox="0 0 220 92" aria-hidden="true">${body}</svg>`;
const arrow = (x, y, length, kind) =>
  `<path class="${kind}" d="M${x} ${y}h${length}m${length > 0 ? -7 : 7} -4l${length > 0 ? 7 : -7} 4l${length > 0 ? -7 : 7} 4"/>`;

export const TERMS = {
  motor_inertia: {name: 'B_θ', text: 'the inertia of the motors that an impact still feels behind the torque loop: more than nothing, ' +
    'less than that of the whole rotors (B_ρ). It adds to the inertia of the links.',
  svg: sketch(`<circle class="soft" cx="34" cy="42" r="24"/><text x="34" y="47">B_θ</text><path class="line" d="M58 42h8l4 -9 8 18 8 -18 8 18 8 -18 4 9h6"/>
    <rect class="soft" x="112" y="27" width="44" height="30" rx="5"/><text x="134" y="47">M</text>
    <rect class="object" x="170" y="25" width="34" height="34"/>${arrow(122, 17, 26, 'before')}
    <text class="small" x="34" y="82">motor</text><text class="small" x="84" y="82">gear</text><text class="small" x="134" y="82">link</text><text class="small" x="187" y="82">object</text>`)},
  settled: {name: 'Settled contact', text: 'pad and object once the bouncing is over: they move as one body, with one velocity ' +
    'and one rotation. A grab is compared with it.',
  svg: sketch(`<rect class="soft" x="52" y="20" width="22" height="46" rx="3"/><rect class="object" x="74" y="18" width="52" height="50"/>
    ${arrow(62, 10, 44, 'after')}${arrow(100, 78, 44, 'after')}<text class="small" x="30" y="47">pad</text><text class="small" x="158" y="47">object</text>`)},
  reference: {name: 'Reference', text: 'the velocity that the controller is to keep after the impact. A campaign tries several, ' +
    'below and above the predicted one.',
  svg: sketch(`<path class="axis" d="M22 10v64h186"/><path class="before" d="M22 22h76"/><path class="axis dash" d="M98 12v62"/>
    <path class="soft-line" d="M98 36h104"/><path class="after" d="M98 46h104"/><path class="soft-line" d="M98 56h104"/>
    <text class="small" x="58" y="16">before</text><text class="small" x="150" y="31">above</text><text class="small" x="150" y="70">below</text>
    <text class="small" x="98" y="88">impact</text>`)},
  net_feedback: {name: 'Net feedback', text: 'what the controller adds by feedback around the impact, summed up over time. It is zero where ' +
    'the reference is the velocity that the robot really has: there lies the measured value.',
  svg: sketch(`<path class="axis" d="M22 10v68M22 46h186"/><path class="line" d="M40 66L196 20"/>
    <circle class="dot" cx="70" cy="57" r="4"/><circle class="dot" cx="100" cy="48.5" r="4"/><circle class="dot" cx="130" cy="39.5" r="4"/><circle class="dot" cx="160" cy="30.5" r="4"/>
    <path class="after" d="M108 46v-26m-4 19l4 7l4 -7"/><text class="small" x="108" y="15">measured</text><text class="small" x="170" y="62">reference</text>`)},
};

// The terms of a step, in the order in which they are met.
export const TERMS_OF = {predict: ['motor_inertia', 'settled'], measure: ['reference', 'net_feedback'],
  compare: ['settled'], diagnose: ['net_feedback', 'motor_inertia'], add: [], history: [], overlay: ['reference'],
  investigate: ['net_feedback', 'reference']};
