/* Adaptive binary arithmetic coding, one code path for both directions: a function that codes a value writes it when the coder encodes, and
 * reads and returns it when it decodes, so the two cannot drift apart.
 *
 * Probabilities are integers of 16 bits, mixed in the logistic domain with integer weights: the same bits everywhere. Not rANS, whose
 * encoder runs backwards: here what a bit is expected to be follows from all before it, and mixed models learn with each.
 * Based on: Martin. Range encoding. 1979; Mahoney. Adaptive Weighing of Context Models for Lossless Data Compression. 2005. */
#ifndef LOD_CODEC_STREAM_CODER_H
#define LOD_CODEC_STREAM_CODER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/arena.h"
#include "core/base/status.h"

/* How likely the next bit is 1 in one context. Zeroed: knows nothing. */
struct lod_bit_model {
  uint16_t skew;  /* probability of 1, less a half: zeroed memory is a fresh model */
  uint16_t count; /* bits seen, up to a limit */
};

enum { LOD_MIX_INPUTS = 6 };

/* Weights of the models that vote on one kind of bit. Zeroed: equal weights. */
struct lod_mixer {
  int32_t weights[LOD_MIX_INPUTS];
};

enum { LOD_STRETCH_LIMIT = 2047, LOD_STRETCH_ONE = 256 /* of ln(p / (1 - p)) */, LOD_DIVISORS = 1024 + 2 };

struct lod_coder_tables {
  int16_t stretch[4096];                      /* of a probability of 12 bits */
  uint16_t squash[2 * LOD_STRETCH_LIMIT + 2]; /* its inverse, with 16 bits */
  uint16_t divisor[LOD_DIVISORS];             /* 65536 / (n + 1.5) */
};

/* What the models of a whole stream had learnt at its end. A stream that begins from there costs less when it is like that one. */
enum { LOD_CODER_KINDS = 5 };
struct lod_coder_memory {
  uint32_t count;
  size_t sizes[LOD_CODER_KINDS];
  void *blocks[LOD_CODER_KINDS];
};

struct lod_coder {
  bool decoding;
  bool failed; /* encoding: memory is out */
  uint32_t low, high, code;
  const uint8_t *in, *in_end; /* decoding */
  uint32_t overrun;           /* bytes read behind the end */
  uint8_t *out;               /* encoding; in `arena` */
  size_t out_size, out_capacity;
  struct lod_arena *arena;
  const struct lod_coder_tables *tables;
  const struct lod_coder_memory *primer; /* NULL, or where models begin */
  struct lod_coder_memory memory;        /* the models themselves */
};

/* Shared by all coders of a job. NULL when memory is out. */
const struct lod_coder_tables *lod_coder_tables_create(struct lod_arena *arena);

void lod_coder_encode(struct lod_coder *coder, const struct lod_coder_tables *tables, struct lod_arena *arena);
void lod_coder_decode(struct lod_coder *coder, const struct lod_coder_tables *tables, const uint8_t *bytes, size_t size);

/* Encoding: the last bytes. False when memory is out. Decoding: whether the bytes were exactly used up. */
LOD_WARN_UNUSED bool lod_coder_finish(struct lod_coder *coder);

/* Models of the next kind, zeroed, or as the primer's of that kind; the coder remembers them. At most LOD_CODER_KINDS calls. */
void *lod_coder_models(struct lod_coder *coder, size_t size, struct lod_arena *arena);
/* A copy of all of them. NULL when memory is out. */
struct lod_coder_memory *lod_coder_remember(const struct lod_coder *coder, struct lod_arena *arena);

/* Decoding: more was read than there is. Loops that a stream controls ask this. */
static inline bool lod_coder_overrun(const struct lod_coder *coder) {
  return coder->overrun > 4;
}

/* ---- bits ---- */

/* Limits of lod_bit_model.count: how slowly a model forgets. */
enum { LOD_ADAPT_FAST = 30, LOD_ADAPT = 255, LOD_ADAPT_SLOW = 1023 };

/* ---- inline, for most of a decoder's time is here ---- */

static inline uint32_t lod_coder_next_byte(struct lod_coder *c) {
  if (c->in < c->in_end)
    return *c->in++;
  c->overrun += c->overrun < 1000;
  return 0;
}

void lod_coder_put_byte(struct lod_coder *coder, uint32_t byte);

/* p: probability of 1, in (0, 65536). */
static inline int lod_coder_code(struct lod_coder *c, uint32_t p, int bit) {
  const uint32_t middle = c->low + (uint32_t)(((uint64_t)(c->high - c->low) * p) >> 16);
  if (c->decoding)
    bit = c->code <= middle;
  if (bit) /* a branch: bits are foreseen more often than not, and nothing waits then */
    c->high = middle;
  else
    c->low = middle + 1;
  while (((c->low ^ c->high) >> 24) == 0) {
    if (c->decoding)
      c->code = c->code << 8 | lod_coder_next_byte(c);
    else
      lod_coder_put_byte(c, c->high >> 24);
    c->low <<= 8;
    c->high = c->high << 8 | 255;
  }
  return bit;
}

static inline uint32_t lod_coder_probability(const struct lod_bit_model *m) {
  return (uint16_t)(m->skew + 32768u);
}

static inline void lod_coder_learn(const struct lod_coder *c, struct lod_bit_model *m, int limit, int bit) {
  const uint32_t p = lod_coder_probability(m), way = bit ? 65535 - 16 - p : p - 16,
                 by = way * c->tables->divisor[m->count] >> 16; /* below 2^32 */
  m->skew = (uint16_t)((bit ? p + by : p - by) - 32768);
  m->count = (uint16_t)(m->count + (m->count < limit));
}

static inline int lod_coder_bit(struct lod_coder *c, struct lod_bit_model *m, int limit, int bit) {
  const uint32_t p = lod_coder_probability(m);
  bit = lod_coder_code(c, p < 16 ? 16 : p, bit);
  lod_coder_learn(c, m, limit, bit);
  return bit;
}

/* The bit as `count` models (2 to LOD_MIX_INPUTS, a constant) together expect it. Sums fit: 6 inputs of 2047, weights of 157286 at most. */
static inline int lod_coder_mix(struct lod_coder *c, struct lod_bit_model *const *models, int count, struct lod_mixer *mixer, int limit,
                                int bit) {
  int32_t inputs[LOD_MIX_INPUTS], sum = 0;
  for (int i = 0; i < count; i++) {
    inputs[i] = c->tables->stretch[lod_coder_probability(models[i]) >> 4];
    sum += inputs[i] * (mixer->weights[i] + 65536 * 2 / 5);
  }
  int32_t s = sum / 65536;
  s = s > LOD_STRETCH_LIMIT ? LOD_STRETCH_LIMIT : s < -LOD_STRETCH_LIMIT ? -LOD_STRETCH_LIMIT : s;
  const uint32_t p = c->tables->squash[s + LOD_STRETCH_LIMIT];
  bit = lod_coder_code(c, p, bit);
  const int32_t error = (bit ? 65536 : 0) - (int32_t)p;
  for (int i = 0; i < count; i++) {
    const int32_t w = mixer->weights[i] + inputs[i] * error / 16384; /* rate about 0.004 */
    mixer->weights[i] = w > 131072 ? 131072 : w < -131072 ? -131072 : w;
    lod_coder_learn(c, models[i], limit, bit);
  }
  return bit;
}

/* ---- numbers ---- */

/* The low `count` bits (0 to 32) of value, not modelled. */
uint32_t lod_coder_raw(struct lod_coder *coder, uint32_t value, int count);

/* Any number: its length in bits in unary, each step modelled, then its bits, the first one modelled. */
struct lod_number_model {
  struct lod_bit_model length[33], first[33];
};
uint32_t lod_coder_number(struct lod_coder *coder, struct lod_number_model *model, uint32_t value);
int32_t lod_coder_signed(struct lod_coder *coder, struct lod_number_model *model, struct lod_bit_model *sign, int32_t value);

#endif
