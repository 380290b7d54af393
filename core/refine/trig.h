/* Angles from + - * / and sqrt alone, so that a decision is the same on every machine and in WebAssembly. Inside core/refine. */
#ifndef LOD_CORE_REFINE_TRIG_H
#define LOD_CORE_REFINE_TRIG_H

double refine_sin_degrees(double degrees); /* |degrees| <= 360 */
/* Angle between two directions of any length, degrees in [0, 180]; 0 when one of them is 0. dot and the lengths' squares. */
double refine_angle_degrees(double dot, double length2_a, double length2_b);

#endif
