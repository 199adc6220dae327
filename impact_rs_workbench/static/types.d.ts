// SPDX-License-Identifier: Apache-2.0
// What scripts of the page get from others: the server's answers (impact_rs_workbench/workspace.py, jobs.py, forms.py)
// and libraries that the page loads. Read by `deno check` alone.
// deno-lint-ignore-file no-explicit-any

export interface Option { value: string; text: string; on?: boolean }

export interface Workspace {
  root: string;
  campaigns: {path: string; scenario: string; present: number; trials: number; error: string; loose: string[]}[];
  laboratories: {path: string; experiment: string; recordings: string[]; error: string; scenario: string}[];
  models: Model[];
  diagnoses: {path: string; verdict: string; model: string; digest: string}[];
  reports: string[];
  plans: string[];
  tables: string[];
  calibrations: string[];
  packages: string[];
  formulas: string[];
  robots: string[];
  scenarios: string[];
  runs: string[];
  blinds: string[];
  stamps: Record<string, number>; // time of the last change of a file, by its path
}

export interface Model {
  path: string; name: string; digest: string; parent: string | null; effects: string[]; note: string; error: string;
  scores: Score[]; score: Score | null;
}

export interface Score { report: string; fit: number; held_out: number | null; floor: number; unit: string }

export interface Job {
  number: number;
  command: string; // as it is typed in a terminal
  arguments: string[];
  writes: string[];
  started: number; // s
  ended: number | null; // s; null: it runs
  exit_code: number | null;
  line: string;
  stopping: boolean;
  printed: number;
  progress: {what?: string; done?: number; total?: number | null; left?: number | null; share?: number | null;
    ranking?: [string, number][]} | null;
  question: {number: number; text: string} | null;
}

// A field of the form of a command.
export interface Field {
  name: string; label: string; help: string; kind: string; unit: string; choices: string[]; default: any;
  required: boolean; advanced: boolean; many: boolean; least: number | null; most: number | null; otherwise: string;
  spelled: string;
}

// A figure of Plotly, and the element in which it is drawn.
export interface Figure { data: any[]; layout: any }
export type Plot = HTMLDivElement & {
  data?: any[]; layout?: any; _fullLayout?: any; on?(event: string, act: (event: any) => void): void;
  redrawn?(): void; // draws the figure again where its width has changed more than its axes
};

// A step of the workbench, or a tab of one.
export interface Step {
  build(): HTMLElement;
  update(): void; // the folder has changed, or the step has come into sight
  sightChanged?(): void; // another step or tab has come into sight
  tabs?: import('./tools.js').Tabs;
}

declare global {
  const Plotly: any;
  const ImpactReplay: any;
  const ImpactPicture: any;
  const ImpactLive: any;
  interface Window { impact_rs: any } // for the browser's console
}
