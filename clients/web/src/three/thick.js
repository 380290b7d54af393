/**
 * Thick edges and points: what clustering leaves of long thin parts, drawn as round bars and balls.
 *
 * Based on: Low, Tan. Model Simplification Using Vertex-Clustering. I3D 1997, section 3.3: a quad that faces the camera, T / R pixels wide,
 * lit with the dynamic normal ((V1 - C) x (V2 - C)) x (V2 - V1).
 * Where we differ: across the quad the normal turns as on a cylinder of the edge's thickness, with the dynamic normal in its middle; the ends
 * are round, so that edges which meet leave no notch; below one pixel the width stays one pixel and the alpha is the part of
 * it that the edge covers. A point is an edge of length 0, a ball.
 *
 * Light, tone and fog are those of the triangles around: this extends MeshStandardMaterial and replaces position and normal only.
 */

import { DoubleSide, InstancedBufferAttribute, InstancedBufferGeometry, BufferAttribute, MeshStandardMaterial, Sphere, Vector3 } from 'three';

/* Corners of the quad: x along the edge (0 start, 1 end), y across (-1, 1). */
const CORNERS = new Float32Array([0, -1, 0, 1, -1, 0, 1, 1, 0, 0, 1, 0]);
const QUAD = [0, 1, 2, 0, 2, 3];

const VERTEX_DECLARATIONS = `
  attribute vec3 lodStart;
  attribute vec3 lodEnd;
  attribute float lodThickness;
  uniform float lodHeight; /* of the viewport, pixels */
  varying vec2 vLodPlace;   /* units of the drawn radius; x from the start along the edge, y across */
  varying float vLodLength; /* same units */
  varying float vLodCover;
  varying vec3 vLodSide, vLodFront, vLodAlong;
  varying vec4 vLodDepth;   /* z in view space, depth of the bar's front before its axis, and what turns z into depth */
`;

/* In view space the camera C is the origin, so V - C is V. */
const VERTEX_POSITION = `
  vec3 lodA = (modelViewMatrix * vec4(lodStart, 1.0)).xyz;
  vec3 lodB = (modelViewMatrix * vec4(lodEnd, 1.0)).xyz;
  /* An end behind the camera would turn the quad inside out: cut the edge just in front of it. */
  float lodNear = -1e-4 * max(length(lodA), length(lodB));
  if (lodA.z > lodNear && lodB.z < lodNear) lodA = mix(lodA, lodB, (lodA.z - lodNear) / (lodA.z - lodB.z));
  if (lodB.z > lodNear && lodA.z < lodNear) lodB = mix(lodB, lodA, (lodB.z - lodNear) / (lodB.z - lodA.z));
  vec3 lodEdge = lodB - lodA;
  float lodLong = length(lodEdge);
  vec3 lodMiddle = 0.5 * (lodA + lodB);
  vec3 lodSideways = cross(lodA, lodB);
  bool lodIsPoint = length(lodSideways) <= 1e-7 * dot(lodMiddle, lodMiddle);
  vec3 lodToCamera = normalize(-lodMiddle);
  if (lodIsPoint) lodSideways = cross(lodToCamera, abs(lodToCamera.y) < 0.9 ? vec3(0.0, 1.0, 0.0) : vec3(1.0, 0.0, 0.0));
  lodSideways = normalize(lodSideways);
  vec3 lodDirection = lodIsPoint ? normalize(cross(lodSideways, lodToCamera)) : lodEdge / lodLong;
  vec3 lodNormal = normalize(cross(lodSideways, lodDirection)); /* ((V1-C) x (V2-C)) x (V2-V1) */
  if (dot(lodNormal, lodToCamera) < 0.0) lodNormal = -lodNormal;

  /* projectionMatrix[1][1] = 1 / tan(fov / 2): R = 2 D tan(fov / 2) / height */
  float lodUnitsPerPixel = 2.0 / (projectionMatrix[1][1] * lodHeight) * max(-mix(lodA.z, lodB.z, position.x), 1e-20);
  /* Thickness is in the part's own units; an instance may be stretched. */
  float lodStretch = max(length(modelMatrix[0].xyz), max(length(modelMatrix[1].xyz), length(modelMatrix[2].xyz)));
  float lodRadius = 0.5 * lodThickness * lodStretch;
  float lodDrawn = max(lodRadius, 0.5 * lodUnitsPerPixel);
  vLodCover = lodRadius / lodDrawn;
  /* Ends stick out by the radius, but not where the bar is thinner than a pixel: that would make dashes of it. */
  float lodCap = lodRadius;
  vec3 lodPlaced = mix(lodA, lodB, position.x) + (position.x * 2.0 - 1.0) * lodCap * lodDirection + position.y * lodDrawn * lodSideways;
  vLodPlace = vec2(position.x * lodLong + (position.x * 2.0 - 1.0) * lodCap, position.y * lodDrawn) / lodDrawn;
  vLodLength = lodLong / lodDrawn;
  vLodDepth = vec4(lodPlaced.z, lodRadius * lodNormal.z, projectionMatrix[2][2], projectionMatrix[3][2]);
  vLodSide = lodSideways;
  vLodFront = lodNormal;
  vLodAlong = lodDirection;
`;

const FRAGMENT_DECLARATIONS = `
  varying vec2 vLodPlace;
  varying float vLodLength;
  varying float vLodCover;
  varying vec3 vLodSide, vLodFront, vLodAlong;
  varying vec4 vLodDepth;
`;

/* Where on the bar this is: u from the axis, in radii. Past an end it is a ball around that end. */
const FRAGMENT_SHAPE = `
  float lodPast = vLodPlace.x < 0.0 ? vLodPlace.x : max(vLodPlace.x - vLodLength, 0.0);
  vec2 lodOff = vec2(lodPast, vLodPlace.y);
  float lodReach = dot(lodOff, lodOff);
  if (lodReach > 1.0) discard;
  diffuseColor.a *= clamp(vLodCover, 0.0, 1.0);
  /* As deep as a round bar is, so that bars meet one another and triangles where they should. */
  float lodZ = vLodDepth.x + vLodDepth.y * sqrt(max(0.0, 1.0 - lodReach));
  gl_FragDepth = clamp(0.5 + 0.5 * (vLodDepth.z * lodZ + vLodDepth.w) / -lodZ, 0.0, 1.0);
`;

const FRAGMENT_NORMAL = `
  float faceDirection = 1.0;
  vec3 normal = normalize(lodOff.y * normalize(vLodSide) + lodOff.x * normalize(vLodAlong) + sqrt(max(0.0, 1.0 - lodReach)) * normalize(vLodFront));
  vec3 nonPerturbedNormal = normal;
`;

/**
 * The material that draws bars in the colours of `base` (a MeshStandardMaterial, or any with a color).
 * height: uniform {value}, the viewport's height in pixels, kept up to date by whoever renders
 */
export function thickMaterial(base, vertexColors, height) {
  const material = new MeshStandardMaterial({
    color: base.color,
    metalness: base.metalness ?? 0,
    roughness: base.roughness ?? 0.8,
    emissive: base.emissive ?? 0x000000,
    opacity: base.opacity,
    vertexColors,
    side: DoubleSide,
    transparent: true,
    alphaTest: base.alphaTest ?? 0,
  });
  material.onBeforeCompile = (shader) => {
    shader.uniforms.lodHeight = height;
    shader.vertexShader = VERTEX_DECLARATIONS + shader.vertexShader
      .replace('#include <beginnormal_vertex>', `${VERTEX_POSITION}\nvec3 objectNormal = vec3(0.0, 0.0, 1.0);`)
      .replace('#include <project_vertex>', 'vec4 mvPosition = vec4(lodPlaced, 1.0);\ngl_Position = projectionMatrix * mvPosition;');
    shader.fragmentShader = FRAGMENT_DECLARATIONS + shader.fragmentShader
      .replace('#include <color_fragment>', `#include <color_fragment>\n${FRAGMENT_SHAPE}`)
      .replace('#include <normal_fragment_begin>', FRAGMENT_NORMAL);
  };
  material.customProgramCacheKey = () => 'lod-thick';
  return material;
}

/** Geometry of bars for a glTF LINES primitive as GLTFLoader made it (LineSegments, LineLoop, Line), with thickness from _THICKNESS. */
export function thickLines(line) {
  return bars(line.geometry, segments(line));
}

/** Geometry of balls for a POINTS primitive. */
export function thickPoints(points) {
  const index = points.geometry.index;
  const count = index ? index.count : points.geometry.attributes.position.count;
  const pairs = new Uint32Array(count * 2);
  for (let i = 0; i < count; i++) pairs[2 * i] = pairs[2 * i + 1] = index ? index.getX(i) : i;
  return bars(points.geometry, pairs);
}

function segments(line) {
  const index = line.geometry.index;
  const count = index ? index.count : line.geometry.attributes.position.count;
  const at = (i) => (index ? index.getX(i) : i);
  if (line.isLineSegments) return Uint32Array.from({ length: count - (count % 2) }, (_, i) => at(i));
  const pairs = [];
  for (let i = 0; i + 1 < count; i++) pairs.push(at(i), at(i + 1));
  if (line.isLineLoop && count > 2) pairs.push(at(count - 1), at(0));
  return Uint32Array.from(pairs);
}

function bars(source, pairs) {
  const { position, color, _thickness: thickness } = source.attributes;
  const count = pairs.length / 2;
  const start = new Float32Array(count * 3);
  const end = new Float32Array(count * 3);
  const width = new Float32Array(count);
  const colors = color ? new Float32Array(count * 3) : null;
  const sphere = new Sphere().makeEmpty();
  const place = new Vector3();
  let widest = 0;
  for (let i = 0; i < count; i++) {
    const a = pairs[2 * i];
    const b = pairs[2 * i + 1];
    start.set(place.fromBufferAttribute(position, a).toArray(), 3 * i);
    sphere.expandByPoint(place);
    end.set(place.fromBufferAttribute(position, b).toArray(), 3 * i);
    sphere.expandByPoint(place);
    width[i] = thickness ? Math.max(0, Math.max(thickness.getX(a), thickness.getX(b))) : 0;
    widest = Math.max(widest, width[i]);
    if (colors) colors.set([(color.getX(a) + color.getX(b)) / 2, (color.getY(a) + color.getY(b)) / 2, (color.getZ(a) + color.getZ(b)) / 2], 3 * i);
  }
  sphere.radius += widest;

  const geometry = new InstancedBufferGeometry();
  geometry.instanceCount = count;
  geometry.setIndex(QUAD);
  geometry.setAttribute('position', new BufferAttribute(CORNERS, 3));
  geometry.setAttribute('lodStart', new InstancedBufferAttribute(start, 3));
  geometry.setAttribute('lodEnd', new InstancedBufferAttribute(end, 3));
  geometry.setAttribute('lodThickness', new InstancedBufferAttribute(width, 1));
  if (colors) geometry.setAttribute('color', new InstancedBufferAttribute(colors, 3));
  geometry.boundingSphere = sphere;

  return geometry;
}
