// Elements without markup from strings: user text gets in as text only.

type Child = Node | string | null | undefined | false;
type Attributes = Record<string, string | number | boolean | ((event: Event) => void)>;

function fill<T extends Element>(element: T, attributes: Attributes, children: Child[]): T {
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false) element.setAttribute(name, String(value));
  }
  element.append(...children.filter((child): child is Node | string => child !== null && child !== undefined && child !== false));
  return element;
}

/** An HTML element; attributes that are functions are listeners (`onclick`). */
export function h<K extends keyof HTMLElementTagNameMap>(tag: K, attributes: Attributes = {}, ...children: Child[]) {
  return fill(document.createElement(tag), attributes, children);
}

/** An SVG element. */
export function s<K extends keyof SVGElementTagNameMap>(tag: K, attributes: Attributes = {}, ...children: Child[]) {
  return fill(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
}

/** A group of buttons of which one is pressed. */
export function choice<T extends string>(
  label: string,
  options: { value: T; text: string; disabled?: string }[],
  initial: T,
  choose: (value: T) => void,
): { element: HTMLElement; show: (value: T) => void } {
  const buttons = options.map(({ value, text, disabled }) =>
    h(
      "button",
      { type: "button", "aria-pressed": value === initial, disabled: Boolean(disabled), title: disabled ?? false, "data-value": value, onclick: () => choose(value) },
      text,
    ),
  );
  const show = (value: T) => {
    buttons.forEach((button) => button.setAttribute("aria-pressed", String(button.dataset.value === value)));
  };
  show(initial);
  return { element: h("div", { class: "choice", role: "group", "aria-label": label }, ...buttons), show };
}

/** A box to tick. */
export function tick(text: string, checked: boolean, change: (checked: boolean) => void, disabled = ""): HTMLLabelElement {
  const input = h("input", { type: "checkbox", checked, disabled: Boolean(disabled) });
  input.addEventListener("change", () => change(input.checked));
  return h("label", { class: "tick", title: disabled || false }, input, text);
}

/** A canvas that follows the size of its element and the sharpness of the screen; `draw` gets CSS px. */
export function fitted(canvas: HTMLCanvasElement, width: number, height: number): number {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const [columns, rows] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== columns || canvas.height !== rows) {
    canvas.width = columns;
    canvas.height = rows;
  }
  return ratio;
}

/** Calls a function once before the next frame, however often it is asked to. */
export function onFrame(draw: () => void): () => void {
  let asked = false;
  return () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      draw();
    });
  };
}
