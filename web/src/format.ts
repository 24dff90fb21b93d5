// Numbers as people write them: a true minus sign, no more digits than are known.

const MINUS = "\u2212";
const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹";

/** A number with so many decimals. */
export function fixed(value: number, decimals: number): string {
  const text = value.toFixed(decimals);
  const isZero = Number(text) === 0;
  const [whole, rest] = text.replace("-", "").split(".");
  // Thin spaces between thousands, from five digits on.
  const grouped = whole.length > 4 ? whole.replace(/\B(?=(\d{3})+$)/g, "\u2009") : whole;
  return (value < 0 && !isZero ? MINUS : "") + grouped + (rest ? `.${rest}` : "");
}

/** A number with about so many digits that count, without an exponent. */
export function digits(value: number, count = 3): string {
  if (!Number.isFinite(value)) return "unknown";
  const magnitude = value === 0 ? 0 : Math.floor(Math.log10(Math.abs(value)));
  return fixed(value, Math.min(6, Math.max(0, count - 1 - magnitude)));
}

/** A number with up to four digits that count and no zeros at its end. */
export function short(value: number): string {
  return digits(value, 4).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");
}

/** A value and its error with the decimals that the error allows: `5030 ± 69`. */
export function withError(value: number, sigma: number): string {
  const decimals = sigma > 0 ? Math.min(6, Math.max(0, 1 - Math.floor(Math.log10(sigma)))) : 0;
  return `${fixed(value, decimals)} ± ${fixed(sigma, decimals)}`;
}

/** `1.41 × 10⁷`. */
export function scientific(value: number): string {
  if (value >= 0.01 && value < 1e4) return digits(value);
  const [mantissa, exponent] = value.toExponential(2).split("e");
  return `${mantissa} × 10${superscript(exponent.replace("+", ""))}`;
}

/** `m^-2` as `m⁻²`. */
export function unitText(unit: string): string {
  return unit.replace(/\^(-?\d+)/, (_, power: string) => superscript(power));
}

function superscript(text: string): string {
  return [...text].map((letter) => (letter === "-" ? "⁻" : SUPERSCRIPTS[Number(letter)])).join("");
}

/** Degrees with a sign. */
export function degrees(value: number, decimals = 2): string {
  const text = fixed(value, decimals).replace(/\.?0+$/, (zeros) => (zeros.startsWith(".") ? "" : zeros));
  return `${value > 0 ? "+" : ""}${text}°`;
}

/** A round distance between ticks so that about `wanted` of them fit a range. */
export function tickStep(range: number, wanted: number): number {
  if (!(range > 0)) return 1;
  const raw = range / Math.max(1, wanted);
  const power = 10 ** Math.floor(Math.log10(raw));
  return power * ([1, 2, 5, 10].find((factor) => factor * power >= raw * (1 - 1e-9)) ?? 10);
}

/** Round numbers in a range, and how to write them. */
export function ticks(low: number, high: number, wanted: number): { value: number; text: string }[] {
  const step = tickStep(high - low, wanted);
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) {
    found.push({ value: k * step, text: fixed(k * step, decimals) });
  }
  return found;
}

/** The largest of 1, 2, 5 times a power of ten that is not above a value. */
export function roundDown(value: number): number {
  const power = 10 ** Math.floor(Math.log10(value));
  return power * ([5, 2, 1].find((factor) => factor * power <= value * (1 + 1e-9)) ?? 1);
}
