// Draws the comparison without WebGL2: the same as the shader, by tables of what each stored number looks like.

class CanvasRenderer {
  static on(canvas) {
    return new CanvasRenderer(canvas.getContext("2d"));
  }

  constructor(context) {
    this.context = context;
    this.name = "canvas";
    this.largest = Infinity;
  }

  draw(state) {
    const { canvas } = this.context;
    if (canvas.width === 0 || canvas.height === 0) return;
    const target = this.context.createImageData(canvas.width, canvas.height);
    const sides = [state.left, state.right].map((side) => sampler(side, state));
    const mark = marker(state);
    const { width, height } = state.left.picture;
    // Two by two samples at most: this is the slow way.
    const count = state.scale < 0.75 ? 2 : 1;
    const [colour, sum] = [[0, 0, 0], [0, 0, 0]];
    const offsets = Array.from({ length: count }, (_, index) => ((index + 0.5) / count - 0.5) / state.scale);
    for (let row = 0; row < canvas.height; row += 1) {
      for (let column = 0; column < canvas.width; column += 1) {
        const [x, y] = [state.originX + (column + 0.5) / state.scale, state.originY + (row + 0.5) / state.scale];
        if (x < 0 || y < 0 || x >= width || y >= height) continue;
        const sample = sides[Number(column + 0.5 >= state.divider)];
        sum.fill(0);
        for (let part = 0; part < count * count; part += 1) {
          const u = Math.min(Math.max(Math.floor(x + offsets[part % count]), 0), width - 1);
          const v = Math.min(Math.max(Math.floor(y + offsets[Math.floor(part / count)]), 0), height - 1);
          sample(v * width + u, colour);
          mark(v * width + u, column, canvas.height - row, colour);
          for (let channel = 0; channel < 3; channel += 1) sum[channel] += colour[channel];
        }
        const at = 4 * (row * canvas.width + column);
        for (let channel = 0; channel < 3; channel += 1) target.data[at + channel] = sum[channel] / (count * count);
        target.data[at + 3] = 255;
      }
    }
    this.context.putImageData(target, 0, 0);
  }
}

/** What a side of the divider shows of a pixel, written to a colour. */
function sampler({ picture, reference }, state) {
  const shown = developer(picture, state);
  if (!reference) return shown;
  const wanted = developer(reference, state);
  const other = [0, 0, 0];
  return (at, colour) => {
    shown(at, colour);
    wanted(at, other);
    const difference = colour.reduce((sum, value, channel) => sum + Math.abs(value - other[channel]), 0) / 3;
    colour.fill(Math.min(difference * state.differenceGain, 255));
  };
}

function developer(picture, { curve, gain }) {
  const table = picture.table(curve, gain);
  const [codes, step] = picture.half ? [picture.half, 3] : [picture.readBytes(), 4];
  return (at, colour) => {
    for (let channel = 0; channel < 3; channel += 1) colour[channel] = table[codes[step * at + channel]];
    if (colour[0] < 0 || colour[1] < 0 || colour[2] < 0) NOT_A_NUMBER.forEach((v, i) => { colour[i] = v; });
  };
}

/** Tints the pixels of the regions that are shown. */
function marker({ regions, showHighlights, showFlare }) {
  if (!regions || !(showHighlights || showFlare)) return () => {};
  const codes = regions.readBytes();
  const mix = (colour, tint, share) => {
    for (let channel = 0; channel < 3; channel += 1) colour[channel] += share * (tint[channel] - colour[channel]);
  };
  return (at, column, row, colour) => {
    const code = codes[4 * at];
    if (code > 192 && showHighlights) mix(colour, [255, 140, 0], 0.55);
    else if (code > 64 && code <= 192 && showFlare) mix(colour, [26, 191, 255], (column + row) % 8 < 5 ? 0.55 : 0.15);
  };
}
