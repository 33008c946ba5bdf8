// The viewer: two pictures of a scene under one divider, moved and magnified together, developed as one likes.

const SMALLEST_SCALE = 1 / 32;
const LARGEST_SCALE = 96;
const ZOOM_STEP = Math.SQRT2;

/** How near to the divider, in CSS pixels, a pointer takes hold of it. */
const GRIP = 14;

class Viewer {
  constructor(element) {
    this.element = element;
    this.data = JSON.parse(element.querySelector("script").textContent);
    element.append(document.getElementById("viewer-controls").content.cloneNode(true));
    this.parts = {};
    for (const part of element.querySelectorAll("[data-part]")) this.parts[part.dataset.part] = part;
    this.scenes = this.data.scenes.map((described) => this.sceneOf(described));
    this.settings = { divider: 0.5, exposure: 0, amplify: 2, curve: this.data.curve };
    this.pointers = new Map();
    this.startRenderer();
    this.fillChoices();
    this.listen();
    this.chooseScene(0);
    new ResizeObserver(() => this.resize()).observe(this.parts.stage);
  }

  sceneOf(described) {
    const { width, height } = described;
    const scene = { name: described.name, width, height, tone: described.tone, note: described.note || "" };
    scene.pictures = described.pictures.map((picture) => new Picture(picture, scene));
    scene.regions = described.regions ? new Regions(described.regions, scene) : null;
    scene.reference = described.reference;
    return scene;
  }

  /**
   * Chooses WebGL2 if the machine is fast at it and it takes pictures as large as these; `?canvas` in the address does
   * without, `?webgl` insists on it.
   */
  startRenderer() {
    const { canvas } = this.parts;
    const address = new URLSearchParams(location.search);
    const largest = Math.max(...this.scenes.flatMap((scene) => [scene.width, scene.height]));
    const isRefused = address.has("canvas") || largest > largestTexture(address.has("webgl"));
    this.renderer = (isRefused ? CanvasRenderer : GlRenderer).on(canvas);
    this.element.dataset.renderer = this.renderer.name;
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.renderer.textures.clear();
      this.renderer.prepare();
      this.redraw();
    });
  }

  // Choosing

  fillChoices() {
    const { scene, curve } = this.parts;
    this.scenes.forEach(({ name }, index) => scene.append(new Option(name, index)));
    this.parts["scene-choice"].hidden = this.scenes.length < 2;
    CURVES.forEach(({ name }, index) => curve.append(new Option(name, index)));
    curve.value = this.settings.curve;
  }

  chooseScene(index) {
    const scene = this.scenes[index];
    const isSameSize = this.scene?.width === scene.width && this.scene?.height === scene.height;
    const earlier = this.scene && this.chosenNames();
    this.scene = scene;
    this.parts.scene.value = index;
    const { left, right, reference } = this.parts;
    for (const select of [left, right]) select.replaceChildren(...this.sideOptions());
    reference.replaceChildren(...scene.pictures.map((picture, at) => new Option(picture.name, at)));
    reference.value = scene.reference ?? 0;
    const [first, second] = this.usualSides();
    this.chooseSide("left", earlier?.left ?? first, first);
    this.chooseSide("right", earlier?.right ?? second, second);
    this.parts.regions.hidden = !scene.regions;
    this.parts.note.textContent = [scene.note, ...scene.pictures.map(({ note }) => note)].filter(Boolean).join(" ");
    if (!isSameSize) this.view = null;
    this.parts.stage.style.aspectRatio = `${scene.width} / ${scene.height}`;
    this.show();
  }

  /** All pictures, and what each differs by from the reference. */
  sideOptions() {
    const group = (label, mark) => {
      const options = document.createElement("optgroup");
      options.label = label;
      this.scene.pictures.forEach(({ name }, at) => options.append(new Option(mark ? `Difference: ${name}` : name, mark + at)));
      return options;
    };
    const pictures = group("Pictures", "");
    return this.scene.pictures.length < 2 ? [pictures] : [pictures, group("Differences", "d")];
  }

  /** What is compared at first: the first picture, and the last that is not the reference. */
  usualSides() {
    const others = this.scene.pictures.map((_, at) => at).filter((at) => at !== this.scene.reference);
    return [String(others[0] ?? 0), String(others.length > 1 ? others.at(-1) : this.scene.reference ?? others[0] ?? 0)];
  }

  chosenNames() {
    const of = (select) => select.selectedOptions[0]?.textContent;
    return { left: of(this.parts.left), right: of(this.parts.right) };
  }

  /** Chooses by value or by name; else the value `usual`. */
  chooseSide(side, wanted, usual) {
    const options = [...this.parts[side].options];
    const found = options.find((option) => option.value === wanted || option.textContent === wanted);
    this.parts[side].value = found ? found.value : usual;
  }

  /** What a side shows: a picture, and the one that it differs from where the difference is shown. */
  side(name) {
    const { value } = this.parts[name];
    const { pictures } = this.scene;
    const isDifference = value.startsWith("d");
    return {
      picture: pictures[Number(value.replace("d", ""))],
      reference: isDifference ? pictures[Number(this.parts.reference.value)] : null,
    };
  }

  sideName({ picture, reference }) {
    return reference ? `|${picture.name} − ${reference.name}|` : picture.name;
  }

  /** Reads what is chosen and shows it. */
  async show() {
    const [left, right] = [this.side("left"), this.side("right")];
    const { regions } = this.scene;
    const needed = [left.picture, left.reference, right.picture, right.reference, regions].filter(Boolean);
    this.state = null;
    this.parts.wait.textContent = "Reading the pictures…";
    const state = { left, right, regions };
    this.wanted = state;
    try {
      await Promise.all(needed.map((picture) => picture.load()));
    } catch (error) {
      if (this.wanted === state) this.parts.wait.textContent = `The browser cannot read these pictures: ${error.message}`;
      return;
    }
    // The choice may have changed meanwhile.
    if (this.wanted !== state) return;
    this.state = state;
    this.parts.wait.textContent = "";
    for (const name of ["left", "right"]) this.parts[`${name}-name`].textContent = this.sideName(state[name]);
    this.resize();
    this.tell();
  }

  // Moving and magnifying; the view is the place of the middle of the stage, and the CSS pixels for one of the pictures

  fit() {
    const { clientWidth, clientHeight } = this.parts.stage;
    const scale = Math.min(clientWidth / this.scene.width, clientHeight / this.scene.height);
    this.view = { x: this.scene.width / 2, y: this.scene.height / 2, scale, isFitted: true };
  }

  zoomBy(factor, at = null) {
    this.zoomTo(this.view.scale * factor, at);
  }

  /** Magnifies so that what is under a place of the stage stays there. */
  zoomTo(scale, at = null) {
    const { stage } = this.parts;
    const place = at || { x: stage.clientWidth / 2, y: stage.clientHeight / 2 };
    const [x, y] = [place.x - stage.clientWidth / 2, place.y - stage.clientHeight / 2];
    const wanted = Math.min(Math.max(scale, SMALLEST_SCALE), LARGEST_SCALE);
    this.moveBy(x / this.view.scale - x / wanted, y / this.view.scale - y / wanted);
    this.view.scale = wanted;
    this.redraw();
  }

  moveBy(x, y) {
    this.view.x = Math.min(Math.max(this.view.x + x, 0), this.scene.width);
    this.view.y = Math.min(Math.max(this.view.y + y, 0), this.scene.height);
    this.view.isFitted = false;
    this.redraw();
  }

  /** The pixel under a place of the stage, or none. */
  pixelAt({ x, y }) {
    const { stage } = this.parts;
    const column = Math.floor(this.view.x + (x - stage.clientWidth / 2) / this.view.scale);
    const row = Math.floor(this.view.y + (y - stage.clientHeight / 2) / this.view.scale);
    const isInside = column >= 0 && row >= 0 && column < this.scene.width && row < this.scene.height;
    return isInside ? { x: column, y: row } : null;
  }

  // Drawing

  resize() {
    const { stage, canvas } = this.parts;
    const density = window.devicePixelRatio || 1;
    const [width, height] = [stage.clientWidth, stage.clientHeight].map((side) => Math.round(side * density));
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    if (!this.view || this.view.isFitted) this.fit();
    this.redraw();
  }

  redraw() {
    if (this.isDue) return;
    this.isDue = true;
    requestAnimationFrame(() => {
      this.isDue = false;
      this.draw();
    });
  }

  draw() {
    const { settings, parts, view } = this;
    const { canvas, stage } = parts;
    parts.handle.style.left = `${100 * settings.divider}%`;
    parts["exposure-value"].textContent = `${signed(settings.exposure)} EV`;
    parts["amplify-value"].textContent = `× ${shortNumber(2 ** settings.amplify).replace(/\.?0+$/, "")}`;
    parts.divider.setAttribute("aria-valuetext", `${Math.round(100 * settings.divider)} % from the left`);
    parts.exposure.setAttribute("aria-valuetext", parts["exposure-value"].textContent);
    parts.amplify.setAttribute("aria-valuetext", parts["amplify-value"].textContent);
    if (!this.state) return;
    parts["zoom-value"].textContent = `${shortNumber(100 * view.scale).replace(/(\.\d)\d+$/, "$1").replace(/\.0+$/, "")} %`;
    const density = canvas.width / Math.max(stage.clientWidth, 1);
    const scale = view.scale * density;
    this.renderer.draw({
      ...this.state,
      scale,
      originX: view.x - canvas.width / 2 / scale,
      originY: view.y - canvas.height / 2 / scale,
      divider: settings.divider * canvas.width,
      gain: 2 ** settings.exposure,
      differenceGain: 2 ** settings.amplify,
      curve: settings.curve,
      showHighlights: parts.highlights.checked,
      showFlare: parts.flare.checked,
      kept: new Set([...this.scene.pictures, this.scene.regions]),
    });
    this.element.dataset.drawn = Number(this.element.dataset.drawn || 0) + 1;
    this.read();
  }

  // Telling

  /** Writes the values under the pointer, or in the middle, below the picture. */
  read() {
    const { stage } = this.parts;
    const isPointed = Boolean(this.pointed);
    const pixel = this.pixelAt(this.pointed || { x: stage.clientWidth / 2, y: stage.clientHeight / 2 });
    this.parts.centre.hidden = isPointed || document.activeElement !== this.parts.canvas;
    if (!this.state) return;
    const region = pixel && this.scene.regions?.loading ? this.scene.regions.name(pixel.x, pixel.y) : "";
    const place = pixel ? `Row ${pixel.y}, column ${pixel.x}${region && `, ${region}`}` : "Outside of the picture";
    this.parts.place.textContent = isPointed ? place : `In the middle: ${place.toLowerCase()}`;
    for (const name of ["left", "right"]) {
      this.parts[`${name}-label`].textContent = this.sideName(this.state[name]);
      this.parts[`${name}-value`].replaceChildren(...(pixel ? this.values(this.state[name], pixel) : []));
    }
  }

  /** A pixel's light, channel by channel, with its colour on the screen. */
  values({ picture, reference }, { x, y }) {
    const of = (from) => from.light(x, y);
    const gain = 2 ** this.settings.exposure;
    const bytes = (light) => light.map((value) => developed(value, this.settings.curve, gain, picture.tone));
    const light = of(picture);
    let shown = light.some(Number.isNaN) ? NOT_A_NUMBER : bytes(light);
    let numbers = light;
    if (reference) {
      const other = of(reference);
      numbers = light.map((value, channel) => value - other[channel]);
      const mean = bytes(other).reduce((sum, byte, at) => sum + Math.abs(byte - shown[at]), 0) / 3;
      shown = Array(3).fill(Math.round(Math.min(mean * 2 ** this.settings.amplify, 255)));
    }
    const swatch = document.createElement("span");
    swatch.className = "swatch";
    swatch.style.background = `rgb(${shown.join(" ")})`;
    const isExact = picture.isExact && (!reference || reference.isExact);
    const text = ["R", "G", "B"].map((name, channel) => `${name} ${shortNumber(numbers[channel])}`).join("  ");
    return [swatch, `${isExact ? "" : "≈ "}${text}  (shown as ${shown.join(", ")})`];
  }

  /** Says the state to screen readers once the keys are let go. */
  tell() {
    clearTimeout(this.telling);
    this.telling = setTimeout(() => {
      const { parts } = this;
      const values = ["left", "right"].map((name) => `${parts[`${name}-label`].textContent}: ${parts[`${name}-value`].textContent}`);
      parts.live.textContent = `${parts.place.textContent}. ${values.join(". ")}. Zoom ${parts["zoom-value"].textContent}.`;
      const names = ["left", "right"].map((name) => `${name} ${this.sideName(this.side(name))}`);
      parts.canvas.setAttribute("aria-label", `${this.scene.name}: ${names.join(", ")}. ${parts.keys.textContent}`);
    }, 300);
  }

  // Listening

  listen() {
    const { parts } = this;
    parts.scene.addEventListener("change", () => this.chooseScene(Number(parts.scene.value)));
    for (const name of ["left", "right", "reference"]) parts[name].addEventListener("change", () => this.show());
    const change = (part, name, event, read) => {
      parts[part].addEventListener(event, () => {
        this.settings[name] = read(Number(parts[part].value));
        this.redraw();
      });
    };
    change("divider", "divider", "input", (value) => value / 100);
    change("exposure", "exposure", "input", (value) => value);
    change("amplify", "amplify", "input", (value) => value);
    change("curve", "curve", "change", (value) => value);
    parts.exposure.addEventListener("dblclick", () => this.expose(0));
    for (const name of ["highlights", "flare"]) parts[name].addEventListener("change", () => this.redraw());
    const click = (part, action) => parts[part].addEventListener("click", () => {
      action();
      this.redraw();
      this.tell();
    });
    click("zoom-in", () => this.zoomBy(ZOOM_STEP));
    click("zoom-out", () => this.zoomBy(1 / ZOOM_STEP));
    click("fit", () => this.fit());
    click("actual", () => this.zoomTo(1 / (window.devicePixelRatio || 1)));
    parts.canvas.addEventListener("keydown", (event) => this.press(event));
    for (const event of ["focus", "blur"]) parts.canvas.addEventListener(event, () => this.redraw());
    this.listenToPointers(parts.stage);
  }

  listenToPointers(stage) {
    const placeOf = (event) => {
      const frame = stage.getBoundingClientRect();
      return { x: event.clientX - frame.left, y: event.clientY - frame.top };
    };
    stage.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      stage.setPointerCapture(event.pointerId);
      const place = placeOf(event);
      this.parts.canvas.focus({ preventScroll: true });
      event.preventDefault();
      this.pointers.set(event.pointerId, place);
      const isAtDivider = Math.abs(place.x - this.settings.divider * stage.clientWidth) < GRIP;
      this.isDividing = this.pointers.size === 1 && isAtDivider;
    });
    stage.addEventListener("pointermove", (event) => {
      const place = placeOf(event);
      this.pointed = place;
      this.drag(event.pointerId, place);
      this.read();
    });
    const release = (event) => {
      this.pointers.delete(event.pointerId);
      this.isDividing = false;
      if (event.pointerType !== "mouse") this.pointed = null;
    };
    for (const event of ["pointerup", "pointercancel"]) stage.addEventListener(event, release);
    stage.addEventListener("pointerleave", () => {
      this.pointed = null;
      this.redraw();
    });
    stage.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && document.activeElement !== this.parts.canvas) return;
      event.preventDefault();
      this.zoomBy(2 ** (-event.deltaY / (event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 6 : 240)), placeOf(event));
    }, { passive: false });
  }

  /** Follows a pointer that is held: the divider, the picture, or, with a second one, the zoom. */
  drag(id, place) {
    const before = this.pointers.get(id);
    if (!before || !this.view) return;
    const other = [...this.pointers].find(([key]) => key !== id)?.[1];
    if (this.isDividing) {
      this.divide(place.x / this.parts.stage.clientWidth);
    } else if (other) {
      const length = (from) => Math.max(Math.hypot(from.x - other.x, from.y - other.y), 1);
      const middle = { x: (place.x + other.x) / 2, y: (place.y + other.y) / 2 };
      this.moveBy((before.x - place.x) / 2 / this.view.scale, (before.y - place.y) / 2 / this.view.scale);
      this.zoomBy(length(place) / length(before), middle);
    } else {
      this.moveBy((before.x - place.x) / this.view.scale, (before.y - place.y) / this.view.scale);
    }
    this.pointers.set(id, place);
  }

  divide(share) {
    this.settings.divider = Math.min(Math.max(share, 0), 1);
    this.parts.divider.value = 100 * this.settings.divider;
    this.redraw();
  }

  expose(stops) {
    const { exposure } = this.parts;
    exposure.value = stops;
    this.settings.exposure = Number(exposure.value);
    this.redraw();
  }

  press(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || !this.view) return;
    const { stage } = this.parts;
    const step = (side) => (event.shiftKey ? 1 : side / 10 / this.view.scale);
    const [across, down] = [step(stage.clientWidth), step(stage.clientHeight)];
    const digit = /^(?:Digit|Numpad)([1-9])$/.exec(event.code)?.[1];
    const actions = {
      ArrowLeft: () => this.moveBy(-across, 0),
      ArrowRight: () => this.moveBy(across, 0),
      ArrowUp: () => this.moveBy(0, -down),
      ArrowDown: () => this.moveBy(0, down),
      "+": () => this.zoomBy(ZOOM_STEP),
      "=": () => this.zoomBy(ZOOM_STEP),
      "-": () => this.zoomBy(1 / ZOOM_STEP),
      0: () => this.fit(),
      "[": () => this.divide(this.settings.divider - 0.05),
      "]": () => this.divide(this.settings.divider + 0.05),
      ",": () => this.expose(this.settings.exposure - 0.5),
      ".": () => this.expose(this.settings.exposure + 0.5),
      d: () => this.toggleDifference(),
    };
    const action = digit ? () => this.choosePicture(Number(digit) - 1, event.shiftKey) : actions[event.key.toLowerCase()] || actions[event.key];
    if (!action) return;
    event.preventDefault();
    this.pointed = null;
    action();
    this.redraw();
    this.tell();
  }

  choosePicture(index, isLeft) {
    if (index >= this.scene.pictures.length) return;
    this.parts[isLeft ? "left" : "right"].value = String(index);
    this.show();
  }

  /** Shows on the right what the picture there differs by from the reference, or the picture again. */
  toggleDifference() {
    const { right } = this.parts;
    const { value } = right;
    right.value = value.startsWith("d") ? value.slice(1) : `d${value}`;
    if (!right.value) right.value = value;
    this.show();
  }
}

/** A number with its sign and two digits. */
function signed(value) {
  return `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(2)}`;
}
