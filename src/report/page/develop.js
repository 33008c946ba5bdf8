// Numbers of files become light, and light becomes what a screen shows: half floats, curves, colours.

/** The value of each of the 65536 half floats (IEEE 754 binary16). */
const HALF_VALUES = (() => {
  const values = new Float32Array(1 << 16);
  for (let bits = 0; bits < values.length; bits += 1) {
    const sign = bits & 0x8000 ? -1 : 1;
    const exponent = (bits >> 10) & 0x1f;
    const fraction = bits & 0x3ff;
    if (exponent === 0) values[bits] = sign * fraction * 2 ** -24;
    else if (exponent === 31) values[bits] = fraction ? NaN : sign * Infinity;
    else values[bits] = sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
  }
  return values;
})();

/** How numbers that are none are shown. */
const NOT_A_NUMBER = [255, 0, 255];

/** The curves that light is shown by; their places in the list are what the shader calls them. */
const CURVES = [
  {
    name: "Tone mapping x/(x+α)",
    // φ∘C of core/tone.rs, shown as it is, as the program's pictures are.
    show(light, tone) {
      const clipped = Math.min(Math.max(light, 0), tone.xMax);
      return clipped / (clipped + tone.alpha);
    },
  },
  {
    name: "sRGB, white at 1",
    show: (light) => encodeSrgb(Math.min(Math.max(light, 0), 1)),
  },
];

/** The transfer curve of sRGB (IEC 61966-2-1), as in core/color.rs. */
function encodeSrgb(light) {
  return light <= 0.0031308 ? 12.92 * light : 1.055 * light ** (1 / 2.4) - 0.055;
}

/** The light that the tone mapping shows as a value: its inverse. */
function expand(value, tone) {
  const limit = tone.xMax / (tone.xMax + tone.alpha);
  const clamped = Math.min(Math.max(value, 0), limit);
  return Math.min((tone.alpha * clamped) / (1 - clamped), tone.xMax);
}

/** The byte on the screen of some light. */
function developed(light, curve, gain, tone) {
  return Math.round(255 * Math.min(Math.max(CURVES[curve].show(light * gain, tone), 0), 1));
}

/** The bytes that base64 stands for. */
function bytesOfBase64(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const characters = atob(text);
  const bytes = new Uint8Array(characters.length);
  for (let at = 0; at < bytes.length; at += 1) bytes[at] = characters.charCodeAt(at);
  return bytes;
}

/** A number as the readout shows it: four digits, whatever its size. */
function shortNumber(value) {
  if (Number.isNaN(value)) return "NaN";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  if (value === 0) return "0";
  const size = Math.abs(value);
  const text = size >= 1e5 || size < 1e-4 ? value.toExponential(2) : value.toPrecision(4);
  return text.replace("-", "−");
}
