// The pictures of a page: read when they are first shown, from half floats where the page holds them, else compressed.

/** An image that the page holds in a compressed form. */
class EmbeddedImage {
  constructor(imageId, { width, height }) {
    this.imageId = imageId;
    this.width = width;
    this.height = height;
    this.image = null;
    this.loading = null;
    this.bytes = null;
  }

  /** Decodes the image; a second call waits for the first. */
  load() {
    this.loading ||= this.read();
    return this.loading;
  }

  async read() {
    this.image = new Image();
    this.image.src = document.getElementById(this.imageId).src;
    await this.image.decode();
  }

  /** Four bytes a pixel: red, green, blue, alpha. */
  readBytes() {
    if (!this.bytes) {
      const canvas = document.createElement("canvas");
      canvas.width = this.width;
      canvas.height = this.height;
      const context = canvas.getContext("2d", { willReadFrequently: true });
      context.drawImage(this.image, 0, 0, this.width, this.height);
      this.bytes = context.getImageData(0, 0, this.width, this.height).data;
    }
    return this.bytes;
  }
}

/** A picture: half floats of light, or a compressed image of tone-mapped values. */
class Picture extends EmbeddedImage {
  /** `described` is what the page's data say of the picture. */
  constructor(described, scene) {
    super(described.image, scene);
    this.name = described.name;
    this.note = described.note || "";
    this.tone = scene.tone;
    this.halfId = described.half || null;
    /** Red, green and blue of each pixel after each other, as the bits of half floats; null of a compressed picture. */
    this.half = null;
  }

  /** Whether its values are the file's own and not those of a compressed image. */
  get isExact() {
    return this.halfId !== null;
  }

  async read() {
    if (!this.isExact) {
      await super.read();
      return;
    }
    // Lets the page be drawn before the work.
    await new Promise((resume) => setTimeout(resume));
    const bytes = bytesOfBase64(document.getElementById(this.halfId).textContent);
    this.half = new Uint16Array(bytes.buffer, bytes.byteOffset, bytes.byteLength / 2);
  }

  /** The light of a pixel: red, green, blue. */
  light(x, y) {
    const at = y * this.width + x;
    if (this.half) return [0, 1, 2].map((channel) => HALF_VALUES[this.half[3 * at + channel]]);
    const bytes = this.readBytes();
    return [0, 1, 2].map((channel) => expand(bytes[4 * at + channel] / 255, this.tone));
  }

  /** For each code that may stand in the data, its byte on the screen; −1 for what is no number. */
  table(curve, gain) {
    const key = `${curve} ${gain}`;
    if (this.tableKey !== key) {
      this.tableKey = key;
      const count = this.half ? HALF_VALUES.length : 256;
      this.tableOfCodes = Int16Array.from({ length: count }, (_, code) => {
        const light = this.half ? HALF_VALUES[code] : expand(code / 255, this.tone);
        return Number.isNaN(light) ? -1 : developed(light, curve, gain, this.tone);
      });
    }
    return this.tableOfCodes;
  }
}

/** The parts of a scene, a byte a pixel: 0 the rest, 128 flare, 255 highlights. */
class Regions extends EmbeddedImage {
  /** Which part a pixel belongs to, in words; empty for the rest. */
  name(x, y) {
    const byte = this.readBytes()[4 * (y * this.width + x)];
    if (byte > 192) return "highlight";
    return byte > 64 ? "flare" : "";
  }
}
