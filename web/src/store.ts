// What all views share: the selected curve, the point under the pointer, the colouring, the theme.

import { type Mode, type Scale, type Theme, scaleOf } from "./colour";
import type { Model } from "./data";

export interface Hover {
  curve: number;
  point: number;
}

type Topic = "selection" | "hover" | "colour" | "theme";

export class Store {
  selected: number | null = null;
  hover: Hover | null = null;
  mode: Mode = "depth";
  theme: Theme;
  scale: Scale;
  private readonly listeners: { topics: Topic[]; listener: () => void }[] = [];
  private readonly dark = window.matchMedia("(prefers-color-scheme: dark)");

  constructor(readonly model: Model) {
    this.theme = this.systemTheme();
    this.scale = scaleOf(model, this.mode, this.theme);
    this.dark.addEventListener("change", () => this.setTheme(this.systemTheme()));
    document.documentElement.dataset.theme = this.theme;
  }

  on(topics: Topic[], listener: () => void): void {
    this.listeners.push({ topics, listener });
  }

  select(curve: number | null): void {
    if (curve === this.selected) return;
    this.selected = curve;
    this.tell("selection");
  }

  point(hover: Hover | null): void {
    if (hover?.point === this.hover?.point) return;
    this.hover = hover;
    this.tell("hover");
  }

  colourBy(mode: Mode): void {
    this.mode = mode;
    this.scale = scaleOf(this.model, mode, this.theme);
    this.tell("colour");
  }

  setTheme(theme: Theme): void {
    this.theme = theme;
    document.documentElement.dataset.theme = theme;
    this.scale = scaleOf(this.model, this.mode, theme);
    this.tell("theme");
    this.tell("colour");
  }

  private systemTheme(): Theme {
    return this.dark.matches ? "dark" : "light";
  }

  private tell(topic: Topic): void {
    for (const { topics, listener } of this.listeners) if (topics.includes(topic)) listener();
  }
}

const tokens = new Map<string, string>();

/** A colour of the page's style. */
export function token(name: string): string {
  const { theme } = document.documentElement.dataset;
  const key = `${theme} ${name}`;
  const known = tokens.get(key) ?? getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  tokens.set(key, known);
  return known;
}
