#include "server/http/deadline.h"

void lod_deadline_accept(struct lod_deadline *deadline, double now) {
  *deadline = (struct lod_deadline){.phase = LOD_PHASE_WAIT, .since = now, .base = 0, .base_known = true};
}

void lod_deadline_enter(struct lod_deadline *deadline, enum lod_phase phase, double now) {
  double first_byte = phase == LOD_PHASE_HEADERS ? deadline->first_byte : 0;
  *deadline = (struct lod_deadline){.phase = phase, .since = now, .first_byte = first_byte};
}

static enum lod_cut check_wait(struct lod_deadline *deadline, const struct lod_deadline_limits *limits, uint64_t received, double now) {
  /* Bytes that were there before the first check of a wait are not told from the last request's: such a peer falls under the idle limit. */
  if (!deadline->base_known) {
    deadline->base = received;
    deadline->base_known = true;
  }
  if (received > deadline->base && deadline->first_byte == 0)
    deadline->first_byte = now;
  if (deadline->first_byte > 0 && now - deadline->first_byte > limits->header_seconds)
    return LOD_CUT_HEADERS;
  return now - deadline->since > limits->idle_seconds ? LOD_CUT_IDLE : LOD_CUT_NO;
}

static bool rate_kept(struct lod_deadline *deadline, const struct lod_deadline_limits *limits, uint64_t bytes, double now) {
  if (deadline->window == 0) {
    deadline->window = now;
    deadline->base = bytes;
  }
  double length = now - deadline->window;
  if (length < limits->rate_seconds)
    return true;
  bool kept = (double)(bytes - deadline->base) >= limits->rate_bytes * length;
  deadline->window = now;
  deadline->base = bytes;
  return kept;
}

enum lod_cut lod_deadline_check(struct lod_deadline *deadline, const struct lod_deadline_limits *limits, uint64_t received,
                                uint64_t acknowledged, double now) {
  switch (deadline->phase) {
  case LOD_PHASE_WAIT:
    return check_wait(deadline, limits, received, now);
  case LOD_PHASE_HEADERS: {
    double began = deadline->first_byte > 0 ? deadline->first_byte : deadline->since;
    return now - began > limits->header_seconds ? LOD_CUT_HEADERS : LOD_CUT_NO;
  }
  case LOD_PHASE_RECEIVE:
    return rate_kept(deadline, limits, received, now) ? LOD_CUT_NO : LOD_CUT_SLOW_SENDER;
  case LOD_PHASE_SEND:
    return rate_kept(deadline, limits, acknowledged, now) ? LOD_CUT_NO : LOD_CUT_SLOW_READER;
  default:
    return LOD_CUT_NO;
  }
}

const char *lod_cut_name(enum lod_cut cut) {
  static const char *const kNames[LOD_CUT_COUNT] = {"no", "headers", "idle", "slow-sender", "slow-reader", "address-limit", "overload"};
  return cut < LOD_CUT_COUNT ? kNames[cut] : "unknown";
}
