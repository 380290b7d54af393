/**
 * Cross-fading two levels without sorting or blending: each pixel shows one of them, chosen by comparing ordered noise with the fade.
 * The two patterns are complementary, so no pixel is drawn by both or by neither, and depth stays right.
 *
 * fade.value: 0 draws nothing, 1 everything; negative -f draws exactly the pixels that f leaves out.
 * Noise: interleaved gradient noise (Jimenez. Next Generation Post Processing in Call of Duty. SIGGRAPH 2014).
 */

const DECLARATION = 'uniform float lodFade;\n';
const DISCARD = `
  if (lodFade < 1.0) {
    float lodNoise = fract(52.9829189 * fract(dot(floor(gl_FragCoord.xy), vec2(0.06711056, 0.00583715))));
    if (lodFade >= 0.0 ? lodNoise >= lodFade : lodNoise < -lodFade) discard;
  }
`;

/** Adds the fade to a built-in material. All materials of a level share `fade`, a uniform {value}. */
export function addFade(material, fade) {
  const before = material.onBeforeCompile;
  const key = material.customProgramCacheKey?.() ?? '';
  material.onBeforeCompile = (shader, renderer) => {
    before?.call(material, shader, renderer);
    shader.uniforms.lodFade = fade;
    shader.fragmentShader = DECLARATION + shader.fragmentShader.replace('void main() {', `void main() {${DISCARD}`);
  };
  material.customProgramCacheKey = () => `${key} lod-fade`;
}
