/** Numbers for people. Pure. */

export function formatCount(n) {
  return Math.round(n).toLocaleString('en');
}

/** 1000-based, as transfer sizes are: "0 B", "512 B", "18.4 kB", "3.03 MB". */
export function formatBytes(bytes) {
  if (!(bytes > 0)) return '0 B';
  const units = ['B', 'kB', 'MB', 'GB', 'TB'];
  let unit = 0;
  let value = bytes;
  while (value >= 999.5 && unit < units.length - 1) {
    value /= 1000;
    unit++;
  }
  return `${unit === 0 ? Math.round(value) : significant(value, 3)} ${units[unit]}`;
}

/** Plain up to five figures, powers of ten beyond: "0.00131", "2.4e-7". */
export function formatUnits(value) {
  if (value === 0) return '0';
  const size = Math.abs(value);
  if (size < 1e-4 || size >= 1e5) return value.toExponential(1).replace('e+', 'e');
  return significant(value, 3);
}

/** Pixels: "0.42", "3.1", "128"; rounded up where it matters that it is a bound: what is 0.004 is "0.01", never "0.00". */
export function formatPixels(px) {
  if (px === 0) return '0';
  if (px < 0.01) return '< 0.01';
  if (px < 10) return String(Math.ceil(px * 100 - 1e-9) / 100);
  if (px < 1000) return String(Math.ceil(px - 1e-9));
  return formatUnits(px);
}

/** "Textures within 29.3 texels, normals within 60°" of what is proven of a level's attributes; "" when nothing is. */
export function formatAttributes(attributes) {
  if (!attributes) return '';
  const { texels, uv, degrees } = attributes;
  const up = (value) => String(Math.ceil(value * 10 - 1e-9) / 10);
  const words = [
    texels !== null ? `textures within ${up(texels)} texels` : uv !== null ? `textures within ${formatUnits(uv)} of UV` : '',
    degrees !== null ? `normals within ${up(degrees)}°` : '',
  ].filter(Boolean).join(', ');
  return words.charAt(0).toUpperCase() + words.slice(1);
}

function significant(value, figures) {
  return String(Number(value.toPrecision(figures)));
}
