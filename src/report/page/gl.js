// Draws the comparison by WebGL2: every pixel of the screen looks up its pixel of the pictures and develops it.

const VERTEX_SHADER = `#version 300 es
void main() {
  // One triangle that covers the canvas.
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}`;

const FRAGMENT_SHADER = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;

uniform sampler2D pictures0, pictures1, pictures2, pictures3, regions;
uniform bvec4 isHalf;          // which pictures hold light; the others hold tone-mapped values
uniform bvec2 isDifference;    // of the left side, of the right one
uniform bvec2 shownRegions;    // highlights, flare
uniform ivec2 size;            // of the pictures
uniform vec2 origin;           // the place in the pictures of the canvas's top left corner
uniform float scale;           // pixels of the screen for one of the pictures
uniform float canvasHeight, divider, gain, differenceGain, alpha, xMax;
uniform int curve;
out vec4 colour;

const vec3 NOT_A_NUMBER = vec3(1.0, 0.0, 1.0);
const vec3 HIGHLIGHTS = vec3(1.0, 0.55, 0.0), FLARE = vec3(0.1, 0.75, 1.0);

vec3 stored(int which, ivec2 at) {
  if (which == 0) return texelFetch(pictures0, at, 0).rgb;
  if (which == 1) return texelFetch(pictures1, at, 0).rgb;
  if (which == 2) return texelFetch(pictures2, at, 0).rgb;
  return texelFetch(pictures3, at, 0).rgb;
}

vec3 encodeSrgb(vec3 light) {
  return mix(12.92 * light, 1.055 * pow(max(light, 0.0031308), vec3(1.0 / 2.4)) - 0.055,
             step(vec3(0.0031308), light));
}

vec3 develop(int which, ivec2 at) {
  vec3 light = stored(which, at);
  if (isHalf[which]) {
    // The least half float stands for what is no number.
    if (any(lessThan(light, vec3(-65000.0)))) return NOT_A_NUMBER;
  } else {
    vec3 value = min(light, vec3(xMax / (xMax + alpha)));
    light = min(alpha * value / (1.0 - value), vec3(xMax));
  }
  light = max(light * gain, 0.0);
  if (curve == 1) return encodeSrgb(min(light, 1.0));
  light = min(light, vec3(xMax));
  return light / (light + alpha);
}

vec3 side(int first, bool difference, ivec2 at) {
  vec3 shown = develop(first, at);
  if (!difference) return shown;
  return vec3(dot(abs(shown - develop(first + 1, at)), vec3(1.0 / 3.0)) * differenceGain);
}

vec3 marked(vec3 shown, ivec2 at) {
  float region = texelFetch(regions, at, 0).r;
  if (region > 0.75 && shownRegions.x) return mix(shown, HIGHLIGHTS, 0.55);
  // Stripes, so that the two are told apart without colours.
  bool stripe = mod(gl_FragCoord.x + gl_FragCoord.y, 8.0) < 5.0;
  if (region > 0.25 && region <= 0.75 && shownRegions.y) return mix(shown, FLARE, stripe ? 0.55 : 0.15);
  return shown;
}

void main() {
  vec2 screen = vec2(gl_FragCoord.x, canvasHeight - gl_FragCoord.y);
  bool isRight = screen.x >= divider;
  vec2 place = origin + screen / scale;
  if (any(lessThan(place, vec2(0.0))) || any(greaterThanEqual(place, vec2(size)))) {
    colour = vec4(0.0);
    return;
  }
  // Where pictures are made smaller, a pixel of the screen is the mean of those that it covers.
  int count = clamp(int(ceil(1.0 / scale - 0.01)), 1, 8);
  vec3 sum = vec3(0.0);
  for (int y = 0; y < count; y++) {
    for (int x = 0; x < count; x++) {
      vec2 offset = ((vec2(x, y) + 0.5) / float(count) - 0.5) / scale;
      ivec2 at = clamp(ivec2(floor(place + offset)), ivec2(0), size - 1);
      vec3 shown = isRight ? side(2, isDifference.y, at) : side(0, isDifference.x, at);
      sum += marked(clamp(shown, 0.0, 1.0), at);
    }
  }
  colour = vec4(sum / float(count * count), 1.0);
}`;

/** Names of renderers that compute on the CPU, which is slower at it than drawing without them. */
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** The largest side of a texture; 0 without WebGL2, or, unless it is insisted on, without a graphics processor. */
function largestTexture(isInsisted) {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return 0;
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  const name = gl.getParameter(names ? names.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
  const largest = gl.getParameter(gl.MAX_TEXTURE_SIZE);
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return SOFTWARE.test(name) && !isInsisted ? 0 : largest;
}

class GlRenderer {
  static on(canvas) {
    // What is drawn is printed and saved as well.
    return new GlRenderer(canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true }));
  }

  constructor(gl) {
    this.gl = gl;
    this.name = "WebGL2";
    this.largest = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    this.textures = new Map();
    this.prepare();
  }

  prepare() {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX_SHADER], [gl.FRAGMENT_SHADER, FRAGMENT_SHADER]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(gl.getProgramInfoLog(program));
    }
    gl.useProgram(program);
    gl.bindVertexArray(gl.createVertexArray());
    this.place = (name) => gl.getUniformLocation(program, name);
    ["pictures0", "pictures1", "pictures2", "pictures3", "regions"].forEach((name, unit) => {
      gl.uniform1i(this.place(name), unit);
    });
    this.nothing = this.upload(null);
  }

  /** A texture of a picture or of regions; of nothing, a black pixel. */
  upload(picture) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    }
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    if (!picture) {
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    } else if (picture.half) {
      const { width, height } = picture;
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB16F, width, height, 0, gl.RGB, gl.HALF_FLOAT, finite(picture.half));
    } else {
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, picture.image);
    }
    return texture;
  }

  /** Keeps the textures of what is shown, and frees the others. */
  textureOf(picture) {
    if (!picture) return this.nothing;
    if (!this.textures.has(picture)) this.textures.set(picture, this.upload(picture));
    return this.textures.get(picture);
  }

  draw(state) {
    const { gl } = this;
    const { left, right, regions } = state;
    const shown = [left.picture, left.reference, right.picture, right.reference, regions];
    for (const [picture, texture] of this.textures) {
      if (!state.kept.has(picture)) {
        gl.deleteTexture(texture);
        this.textures.delete(picture);
      }
    }
    shown.map((picture) => this.textureOf(picture)).forEach((texture, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    });
    const { canvas } = gl;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.uniform4iv(this.place("isHalf"), shown.slice(0, 4).map((picture) => Number(Boolean(picture?.half))));
    gl.uniform2i(this.place("isDifference"), Number(Boolean(left.reference)), Number(Boolean(right.reference)));
    gl.uniform2i(this.place("shownRegions"), Number(state.showHighlights), Number(state.showFlare));
    gl.uniform2i(this.place("size"), left.picture.width, left.picture.height);
    gl.uniform2f(this.place("origin"), state.originX, state.originY);
    for (const name of ["scale", "divider", "gain", "differenceGain"]) gl.uniform1f(this.place(name), state[name]);
    gl.uniform1f(this.place("canvasHeight"), canvas.height);
    gl.uniform1f(this.place("alpha"), left.picture.tone.alpha);
    gl.uniform1f(this.place("xMax"), left.picture.tone.xMax);
    gl.uniform1i(this.place("curve"), state.curve);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}

/** The half floats with numbers for what is none: the least for NaN, the largest for infinity. */
function finite(half) {
  const isNone = (bits) => (bits & 0x7c00) === 0x7c00;
  if (!half.some(isNone)) return half;
  return half.map((bits) => {
    if (!isNone(bits)) return bits;
    return bits & 0x3ff ? 0xfbff : (bits & 0x8000) | 0x7bff;
  });
}
