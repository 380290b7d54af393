/** What the page shows, as the fragment of its address: #model=bunny&px=1&family=cluster. Pure. */

export const DEFAULTS = Object.freeze({ model: null, rule: 'error', px: 1, x: 5, family: 'auto', up: 'y', level: null, spin: false, wire: false });

const LIMITS = { px: [0.1, 64], x: [1, 32] };

/** Unknown names are ignored, values out of range fall back to the default. */
export function parseFragment(fragment) {
  const given = new URLSearchParams(fragment.replace(/^#/, ''));
  const state = { ...DEFAULTS };
  if (given.get('model')) state.model = given.get('model');
  if (given.get('rule') === 'cell') state.rule = 'cell';
  if (given.get('up') === 'z') state.up = 'z';
  if (given.get('family')) state.family = given.get('family');
  for (const name of ['px', 'x']) {
    const value = Number(given.get(name) ?? NaN);
    if (value >= LIMITS[name][0] && value <= LIMITS[name][1]) state[name] = value;
  }
  for (const name of ['spin', 'wire']) if (given.get(name) === '1') state[name] = true;
  if (/^\d{1,6}$/.test(given.get('level') ?? '')) state.level = Number(given.get('level'));
  return state;
}

/** Only what differs from the defaults, model first. "" when nothing does. */
export function formatFragment(state) {
  const out = new URLSearchParams();
  for (const [name, value] of Object.entries(DEFAULTS)) {
    const now = state[name];
    if (now === value || now === null || now === undefined) continue;
    out.set(name, now === true ? '1' : String(now));
  }
  const text = out.toString();
  return text ? `#${text}` : '';
}
