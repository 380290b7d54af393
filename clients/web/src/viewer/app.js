/** The viewer page: puts the view, the model list, the controls and the figures together. */

import { errorPixels, errorUnits, unitsPerPixel } from '../protocol/index.js';
import { Client, FrameBudget, MotionMeter, motionFactor, scheduleLevels } from '../stream/index.js';
import { makeDraco } from '../three/index.js';
import { Chart } from './chart.js';
import { formatAttributes, formatBytes, formatCount, formatPixels, formatUnits } from './format.js';
import { formatFragment, parseFragment } from './location.js';
import { Messages } from './messages.js';
import { ModelList } from './models.js';
import { CorePool } from '../wasm/pool.js';
import { ModelSession } from './session.js';
import { View } from './view.js';

const RECONNECT_SECONDS = [1, 2, 4, 8, 15];
const REFRESH_SECONDS = 20;
const NARROW = 960; /* pixels, as in style.css */
const TOKEN_KEY = 'lodestream-token';
const $ = (id) => document.getElementById(id);

class App {
  constructor() {
    // This file is served from viewer/ beneath the daemon's root, whatever prefix a proxy puts before it.
    const here = new URL('.', import.meta.url);
    this.client = new Client(new URL('..', here).href, { token: () => sessionStorage.getItem(TOKEN_KEY) });
    this.assets = { draco: makeDraco(new URL('draco/', here).href), normalsWorker: new URL('normals-worker.js', here) };
    let core = null;
    this.assets.core = () => (core ??= new CorePool({ worker: new URL('core-worker.js', here), wasm: new URL('lodestream.wasm', here) }));
    this.state = parseFragment(location.hash);
    this.messages = new Messages($('messages'));
    this.session = null;
    this.opening = null;
    this.motion = new MotionMeter();
    this.budget = new FrameBudget();
    this.frameRate = 0;
    const reduced = matchMedia('(prefers-reduced-motion: reduce)');
    this.view = new View($('canvas'), {
      onFrame: (facts) => this.onFrame(facts),
      onShown: () => this.report(),
      reducedMotion: () => reduced.matches,
      morph: (before, next) => (this.morphs ? (this.session?.morph(before, next, $('shapes').value === 'exact') ?? null) : null),
      // A morph that follows the error on screen begins at half the limit, where the finer level is asked for.
      drive: () => (this.followsError ? { limit: this.limit } : null),
    });
    this.reduced = reduced;
    reduced.addEventListener('change', () => (this.view.controls.enableDamping = !reduced.matches));
    this.list = new ModelList({
      list: $('models'),
      uploads: $('uploads'),
      client: this.client,
      ask: ask,
      onOpen: (id) => this.open(id),
      onGone: (id) => this.onGone(id),
      onBaked: (id) => this.onBaked(id),
      onImproved: (id) => this.onImproved(id),
      onError: (text) => this.messages.show(text, { error: true }),
      onUnauthorized: () => ($('token-box').open = true),
    });
    this.chart = new Chart($('chart'), { onPick: (level) => this.pin(level) });
    this.bindControls();
    this.bindPanels();
    this.bindFiles();
    this.bindKeys();
    this.showControls();
    new ResizeObserver(() => this.placePicture()).observe(document.body);
    this.placePicture();
  }

  /** Leaves room for the panels that are always there; sheets on narrow screens come and go over the picture. */
  placePicture() {
    const narrow = innerWidth <= NARROW;
    const side = narrow ? { left: 0, right: 0 } : { left: 270, right: 314 };
    this.view.setInsets({ ...side, top: narrow ? 50 : 10, bottom: narrow ? 112 : 96 });
  }

  // ---- models ----

  async start() {
    addEventListener('hashchange', () => this.onHash());
    if (this.state.model) this.open(this.state.model, { keep: true, early: true }); // the list is not needed for that
    for (let attempt = 0; ; attempt++) {
      try {
        const models = await this.list.refresh();
        this.messages.clear('unreachable');
        attempt = -1;
        this.onList(models);
        await sleep(REFRESH_SECONDS);
      } catch (error) {
        const wait = RECONNECT_SECONDS[Math.min(attempt, RECONNECT_SECONDS.length - 1)];
        this.unreachable(error, wait);
        await sleep(wait);
      }
    }
  }

  unreachable(error, wait) {
    const again = `Trying again in ${wait} second${wait === 1 ? '' : 's'}.`;
    const text = error.kind === 'unreachable' ? `The server at ${location.host} cannot be reached. ${again}` : `${error.message} ${again}`;
    this.messages.show(text, { key: 'unreachable', error: true });
    this.setBusy(false);
  }

  onList(models) {
    $('welcome').hidden = models.length > 0 || this.session !== null;
    if (this.session && !this.opening) {
      const shown = models.find((m) => m.id === this.session.id);
      if (shown && shown.revision !== this.session.manifest.revision) this.onImproved(shown.id);
    }
    if (this.session || this.opening) return;
    const wanted = this.state.model;
    if (wanted && this.missed === wanted && !models.some((m) => m.id === wanted)) return;
    if (wanted) this.open(wanted);
    else if (models.length) this.open(newest(models).id, { keep: true });
    else this.setBusy(false);
  }

  /**
   * keep: leaves family, tolerance and held level of the address as they are (they belong to this model). early: before the list of models has come,
   * which tells of a server that cannot be reached or wants a token; then the model is opened again.
   */
  async open(id, { keep = id === this.state.model, early = false } = {}) {
    this.opening?.abort();
    const opening = (this.opening = new AbortController());
    if (!keep) this.setState({ model: id, level: null });
    this.list.setCurrent(id);
    this.setBusy(true);
    if (innerWidth <= NARROW) this.togglePanel(null);
    try {
      const manifest = await this.client.manifest(id, opening.signal);
      if (opening.signal.aborted) return;
      this.setState({ model: id });
      this.missed = null;
      this.begin(manifest);
    } catch (error) {
      if (opening.signal.aborted) return;
      if (early && error.status !== 404) return;
      this.missed = id;
      this.setBusy(false);
      if (error.status === 404) this.messages.show(`There is no model ${id} on this server.`, { error: true, key: 'open' });
      else this.messages.show(`${id} cannot be shown: ${error.message}`, { error: true, key: 'open' });
    } finally {
      if (this.opening === opening) this.opening = null;
    }
  }

  begin(manifest) {
    const same = this.session?.id === manifest.id;
    this.messages.clear('open');
    this.end();
    $('welcome').hidden = true;
    this.session = new ModelSession({
      client: this.client,
      id: manifest.id,
      manifest,
      assets: this.assets,
      onShow: (level, value) => {
        this.view.show(value.object);
        this.report();
      },
      onDispose: (value) => this.view.forget(value.object),
      onBytes: () => this.report(),
      onError: (error, level) => this.onLevelError(error, level),
      units: {
        wanted: () => $('units').checked,
        look: () => this.view.look(),
        onPart: (part) => this.view.showPart(part, this.morphs),
      },
      onTextureError: (error) => this.messages.show(`A picture of ${manifest.id} is missing: ${error.message}`, { error: true, key: 'texture' }),
    });
    if (this.paused) this.session.pause();
    this.fillFamilies(manifest);
    this.linkPages(manifest);
    this.applyFamily();
    this.showWarnings(manifest.warnings);
    if (same) this.view.setUp(this.state.up);
    else this.view.setModel(manifest.sphere, this.state.up);
    this.motion = new MotionMeter();
    $('canvas').setAttribute('aria-label', `3-D model ${manifest.id}, ${formatCount(manifest.source.triangles ?? 0)} triangles`);
    document.title = `${manifest.id} - Lodestream`;
    $('hud').hidden = false;
    this.onFrame(this.view.facts(performance.now() / 1000, null)); // asks for the first level before anything is drawn
    this.view.invalidate();
  }

  end() {
    if (!this.session) return;
    this.view.show(null);
    this.session.close();
    this.session = null;
    this.chart.setLevels([]);
    $('hud').hidden = $('refine').hidden = true;
    document.title = 'Lodestream';
  }

  onGone(id) {
    this.messages.show(`${id} is deleted.`);
    if (this.session?.id !== id) return;
    this.end();
    this.setState({ model: null, level: null });
    this.onList(this.list.models);
  }

  onBaked(id) {
    this.messages.show(`${id} is ready.`);
    this.open(id, { keep: false });
  }

  /** A new revision of what is looked at: the same place, with more to choose from. */
  onImproved(id) {
    if (this.session?.id === id) this.open(id, { keep: true });
  }

  onLevelError(error, level) {
    if (error.status === 404) {
      // Replaced or deleted while we looked at it: its description tells which.
      this.open(this.session.id, { keep: true });
      return;
    }
    this.messages.show(`Level ${level.level} did not arrive: ${error.message} It is asked for again.`, { error: true, key: 'level' });
  }

  onHash() {
    const next = parseFragment(location.hash);
    const before = this.state;
    this.state = next;
    this.showControls();
    if (next.model && next.model !== before.model) this.open(next.model, { keep: true });
    else if (this.session) {
      this.view.setUp(next.up);
      this.linkPages(this.session.manifest);
      this.applyFamily();
    }
  }

  setState(change) {
    Object.assign(this.state, change);
    const fragment = formatFragment(this.state);
    if (fragment !== location.hash) history.replaceState(null, '', fragment || location.pathname + location.search);
  }

  // ---- each frame ----

  onFrame({ view, eye, target, seconds, frameSeconds }) {
    const session = this.session;
    if (!session) return false;
    const speed = this.motion.update({ eye, target }, seconds);
    const factor = $('motion').checked ? motionFactor(speed) : 1;
    const moving = speed > 0;
    const drawn = this.view.shown?.triangles ?? 0;
    const rate = Number($('rate').value);
    if (frameSeconds !== null && frameSeconds < 1) this.measureRate(frameSeconds, drawn, rate, seconds);
    const tolerance = { rule: this.state.rule, limit: this.limit * factor * (this.followsError ? 0.5 : 1), maxTriangles: this.trianglesWithin(view, moving, rate) };
    session.stream.update(tolerance, view, factor > 1);
    this.lastView = view;
    this.report();
    if (!moving) this.idle();
    return moving;
  }

  get morphs() {
    return $('morph').checked && !this.reduced.matches;
  }

  get followsError() {
    return this.morphs && $('drive').value === 'error' && this.state.rule === 'error';
  }

  /** Nothing moves on by itself: no byte is read and no morph grows until it is taken up again. */
  setPaused(on) {
    this.paused = on;
    $('pause').setAttribute('aria-pressed', String(on));
    $('pause').textContent = on ? 'Resume' : 'Pause';
    if (on) this.session?.pause();
    else this.session?.resume();
    if (on) this.view.driver.pause();
    else this.view.driver.resume();
    this.view.invalidate();
    this.report();
  }

  get limit() {
    return this.state.rule === 'cell' ? this.state.x : this.state.px;
  }

  /** Funkhouser and Sequin's choice for the one object of this page; at rest there is all the time in the world. */
  trianglesWithin(view, moving, rate) {
    if (!rate || !moving || this.budget.triangles === Infinity) return undefined;
    const levels = this.session.levels.map((l) => ({ triangles: l.triangles + l.edges + l.points, error: l.error }));
    const current = this.session.levels.indexOf(this.session.shown);
    const { chosen } = scheduleLevels([{ levels, unitsPerPixel: unitsPerPixel(view), pixels: 1, current }], this.budget.triangles);
    return chosen[0] < 0 ? 0 : levels[chosen[0]].triangles;
  }

  measureRate(frameSeconds, triangles, rate, seconds) {
    this.frameTime = this.frameTime ? this.frameTime + (frameSeconds - this.frameTime) * 0.1 : frameSeconds;
    if (rate) this.budget.add(triangles, frameSeconds, rate, seconds);
    if (seconds - (this.rateShown ?? 0) < 0.25) return;
    this.rateShown = seconds;
    $('hud-rate').textContent = String(Math.round(1 / this.frameTime));
    $('hud-rate-note').textContent = this.state.spin || this.motion.speed > 0 ? 'moving' : '';
  }

  idle() {
    if (this.view.controls.autoRotate) return;
    $('hud-rate-note').textContent = 'at rest';
    if (!$('hud-rate').textContent) $('hud-rate').textContent = '–';
  }

  // ---- figures ----

  /** Writes what is drawn into the overlay; once per frame at most. */
  report() {
    if (this.reporting) return;
    this.reporting = true;
    requestAnimationFrame(() => {
      this.reporting = false;
      this.writeFigures();
    });
  }

  writeFigures() {
    const session = this.session;
    if (!session) return;
    const level = session.shown;
    const settled = session.stream.settled && (!this.view.fading || this.view.resting) && !this.view.waits;
    this.setBusy(!settled);
    $('activity').hidden = !session.stream.busy;
    set('hud-bytes', formatBytes(session.loadedBytes), session.loadedBytes);
    if (!level || !this.lastView) return;
    const px = errorPixels(level.error, this.lastView);
    set('hud-px', `${formatPixels(px)} px`, px);
    set('hud-units', level.error === 0 ? 'exact' : `${formatUnits(level.error)} units`, level.error);
    set('hud-triangles', formatCount(level.triangles), level.triangles);
    set('hud-bars', bars(level), level.edges);
    set('hud-level-bytes', `level: ${formatBytes(level.bytes)}`, level.bytes);
    const own = session.manifest.families.get(level.family).levels;
    set('hud-level', `${level.level} of ${own.length - 1}${this.view.shown?.transient ? ', finer in part' : ''}`, level.level);
    set('hud-family', session.stream.pinned ? `${level.family}, held` : level.family, level.family);
    const grown = this.view.grown;
    set('hud-morph', grown ? `, ${Math.round(100 * grown.t)} % grown` : '', grown ? grown.t : '');
    $('hud-morph').dataset.drawn = grown ? grown.triangles : '';
    const attributes = formatAttributes(level.attributes);
    set('attributes', attributes, attributes);
    $('attributes').hidden = !attributes;
    $('unpin').hidden = session.stream.pinned === null;
    const limit = this.state.rule === 'cell' ? null : errorUnits(this.state.px, this.lastView);
    this.chart.trace(session.trail);
    this.chart.mark(level, session.stream.pinned, limit, `${formatPixels(this.state.px)} px`);
  }

  setBusy(busy) {
    $('stage').setAttribute('aria-busy', String(busy));
  }

  // ---- controls ----

  bindControls() {
    const slider = $('tolerance');
    slider.oninput = () => {
      this.setState(this.state.rule === 'cell' ? { x: Number(slider.value) } : { px: pxOfSlider(slider.value) });
      this.showTolerance();
      this.view.invalidate();
    };
    $('rule').onchange = () => {
      this.setState({ rule: $('rule').value });
      this.showControls();
      this.view.invalidate();
    };
    $('family').onchange = () => {
      this.setState({ family: $('family').value, level: null });
      this.applyFamily();
    };
    $('spin').onchange = () => {
      this.setState({ spin: $('spin').checked });
      this.view.setSpin(this.state.spin);
    };
    $('wire').onchange = () => {
      this.setState({ wire: $('wire').checked });
      this.view.setWireframe(this.state.wire);
    };
    $('up').onchange = () => {
      this.setState({ up: $('up').value });
      this.view.setUp(this.state.up);
      this.view.frame(false);
      if (this.session) this.linkPages(this.session.manifest);
    };
    for (const id of ['motion', 'rate']) {
      $(id).onchange = () => {
        this.budget = new FrameBudget();
        this.view.invalidate();
      };
    }
    for (const id of ['morph', 'drive', 'shapes', 'units']) $(id).onchange = () => this.view.invalidate();
    $('pause').onclick = () => this.setPaused(!this.paused);
    $('unpin').onclick = () => this.pin(null);
    $('token').value = sessionStorage.getItem(TOKEN_KEY) ?? '';
    $('token').onchange = () => sessionStorage.setItem(TOKEN_KEY, $('token').value);
    for (const button of document.querySelectorAll('[data-action="frame"]')) button.onclick = () => this.view.frame();
    for (const button of document.querySelectorAll('[data-action="choose"]')) button.onclick = () => $('file').click();
  }

  showControls() {
    const { state } = this;
    $('rule').value = state.rule;
    $('spin').checked = state.spin;
    $('wire').checked = state.wire;
    $('up').value = state.up;
    this.view.setSpin(state.spin);
    this.view.setWireframe(state.wire);
    const slider = $('tolerance');
    const range = state.rule === 'cell' ? [1, 32, 1] : [-3, 6, 0.25];
    [slider.min, slider.max, slider.step] = range;
    slider.value = state.rule === 'cell' ? state.x : Math.log2(state.px);
    this.showTolerance();
  }

  showTolerance() {
    const { rule, x, px } = this.state;
    const text = rule === 'cell' ? `${x} px a cell` : `${formatPixels(px)} px`;
    $('tolerance-value').textContent = text;
    $('tolerance').setAttribute('aria-valuetext', text);
  }

  fillFamilies(manifest) {
    const options = ['auto', ...manifest.families.keys()].map((name) => new Option(name === 'auto' ? 'auto (fewest bytes)' : name, name));
    $('family').replaceChildren(...options);
    // Low and Tan's rule needs cells.
    const cells = [...manifest.families.values()].some((f) => f.levels.some((l) => l.cell > 0));
    $('rule').options[1].disabled = !cells;
  }

  /** Links to the pages that refine this model in the browser, a mode each, and that draw its curved patches. */
  linkPages(manifest) {
    const address = (page, more) => {
      const asked = new URLSearchParams({ model: manifest.id, ...more, ...(this.state.up === 'z' && { up: 'z' }) });
      return new URL(`${page}#${asked}`, import.meta.url).href;
    };
    for (const link of $('refine').querySelectorAll('a[data-kind]')) link.href = address('refine.html', { kind: link.dataset.kind });
    $('curves').href = address('patches.html');
    $('curves').hidden = !manifest.families.get('clod')?.levels.some((level) => level.patches > 0);
    $('refine').hidden = false;
  }

  applyFamily() {
    const { session, state } = this;
    if (!session) return;
    session.setFamily(state.family);
    $('family').value = session.family;
    this.chart.setLevels(session.levels);
    session.stream.pin(session.levels.find((l) => l.level === state.level) ?? null);
    this.view.invalidate();
  }

  pin(level) {
    const { session } = this;
    if (!session) return;
    const next = level === session.stream.pinned ? null : level;
    session.stream.pin(next);
    if (next && session.family === 'auto' && session.manifest.families.size > 1) this.setState({ family: next.family });
    this.setState({ level: next ? next.level : null });
    this.view.invalidate();
  }

  showWarnings(warnings) {
    const box = $('warnings');
    box.hidden = warnings.length === 0;
    box.querySelector('summary').textContent = warnings.length === 1 ? '1 note about this model' : `${warnings.length} notes about this model`;
    box.querySelector('ul').replaceChildren(
      ...warnings.map((text) => {
        const item = document.createElement('li');
        item.textContent = text;
        return item;
      }),
    );
  }

  bindPanels() {
    $('toggle-models').onclick = () => this.togglePanel('models');
    $('toggle-view').onclick = () => this.togglePanel('view');
    $('canvas').addEventListener('pointerdown', () => this.togglePanel(null));
  }

  /** Narrow screens show one panel at a time; null: none. Asking for the open one closes it. */
  togglePanel(name) {
    for (const each of ['models', 'view']) {
      const open = each === name && !$(`${each}-panel`).classList.contains('open');
      $(`${each}-panel`).classList.toggle('open', open);
      $(`toggle-${each}`).setAttribute('aria-expanded', String(open));
    }
  }

  bindFiles() {
    $('file').onchange = () => {
      this.addFiles([...$('file').files]);
      $('file').value = '';
    };
    let depth = 0;
    const has = (event) => [...(event.dataTransfer?.types ?? [])].includes('Files');
    const dragging = (on) => document.body.classList.toggle('dragging', on);
    addEventListener('dragenter', (event) => has(event) && dragging(++depth > 0));
    addEventListener('dragleave', (event) => has(event) && dragging((depth = Math.max(0, depth - 1)) > 0));
    addEventListener('dragover', (event) => has(event) && event.preventDefault());
    addEventListener('drop', (event) => {
      if (!has(event)) return;
      event.preventDefault();
      depth = 0;
      dragging(false);
      this.addFiles([...event.dataTransfer.files]);
    });
  }

  addFiles(files) {
    if (!files.length) return;
    if (innerWidth <= NARROW && !$('models-panel').classList.contains('open')) this.togglePanel('models');
    this.list.add(files);
  }

  bindKeys() {
    const canvas = $('canvas');
    const keys = {
      ArrowLeft: (s) => (s ? this.view.move(-1, 0) : this.view.turn(-1, 0)),
      ArrowRight: (s) => (s ? this.view.move(1, 0) : this.view.turn(1, 0)),
      ArrowUp: (s) => (s ? this.view.move(0, 1) : this.view.turn(0, -1)),
      ArrowDown: (s) => (s ? this.view.move(0, -1) : this.view.turn(0, 1)),
      '+': () => this.view.zoom(1 / 1.2),
      '=': () => this.view.zoom(1 / 1.2),
      '-': () => this.view.zoom(1.2),
      f: () => this.view.frame(),
      r: () => $('spin').click(),
      w: () => $('wire').click(),
      p: () => $('pause').click(),
      '[': () => this.nudgeTolerance(-1),
      ']': () => this.nudgeTolerance(1),
    };
    canvas.addEventListener('keydown', (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
      if (!action) return;
      event.preventDefault();
      action(event.shiftKey);
    });
    addEventListener('keydown', (event) => event.key === 'Escape' && this.togglePanel(null));
  }

  nudgeTolerance(steps) {
    const slider = $('tolerance');
    if (steps > 0) slider.stepUp();
    else slider.stepDown();
    slider.dispatchEvent(new Event('input'));
  }
}

function pxOfSlider(value) {
  return Number((2 ** Number(value)).toPrecision(3));
}

/** Text for people and the exact figure for programs. */
function set(id, text, value) {
  const element = $(id);
  if (element.textContent !== text) element.textContent = text;
  if (value !== undefined) element.dataset.value = String(value);
}

function bars(level) {
  const parts = [];
  if (level.edges) parts.push(`${formatCount(level.edges)} edge${level.edges === 1 ? '' : 's'}`);
  if (level.points) parts.push(`${formatCount(level.points)} point${level.points === 1 ? '' : 's'}`);
  return parts.length ? `+ ${parts.join(', ')}` : '';
}

function newest(models) {
  return models.reduce((a, b) => (String(b.created ?? '') > String(a.created ?? '') ? b : a));
}

/** choices: [value, label, class]; null when dismissed. */
function ask(text, choices) {
  const dialog = $('ask');
  $('ask-text').textContent = text;
  $('ask-actions').replaceChildren(
    ...choices.map(([value, label, style]) => {
      const button = document.createElement('button');
      button.value = value;
      button.textContent = label;
      if (style) button.className = style;
      return button;
    }),
  );
  dialog.returnValue = '';
  dialog.showModal();
  return new Promise((resolve) => dialog.addEventListener('close', () => resolve(dialog.returnValue || null), { once: true }));
}

function sleep(seconds) {
  return new Promise((resolve) => setTimeout(resolve, seconds * 1000));
}

if (document.createElement('canvas').getContext('webgl2')) {
  const app = new App();
  app.start();
} else {
  new Messages($('messages')).show('This browser has no WebGL 2, which the viewer needs.', { error: true });
  $('stage').setAttribute('aria-busy', 'false');
}
