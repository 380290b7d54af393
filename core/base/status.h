/* Failures that a caller can meet, and the sentence that tells a person which file is wrong, what is wrong and what was expected.
 *
 * Three kinds of failure: a caller's bug is an assert; bad input, I/O, memory and limits are a `lod_status` that is returned;
 * what cannot happen aborts with a sentence. Uploaded bytes never reach an assert. */
#ifndef LOD_CORE_BASE_STATUS_H
#define LOD_CORE_BASE_STATUS_H

enum lod_status {
  LOD_OK = 0,
  LOD_BAD_INPUT,   /* the bytes or the request are wrong */
  LOD_UNSUPPORTED, /* well formed, but asks for what is not built */
  LOD_LIMIT,       /* a stated limit would be broken */
  LOD_MEMORY,      /* no memory, or the job's memory limit is reached */
  LOD_IO,          /* a file or socket failed */
  LOD_CANCELLED,   /* the caller asked to stop */
};

/* What went wrong, for a person and for RFC 9457 `application/problem+json`. */
struct lod_problem {
  enum lod_status status;
  char type[48];    /* stable, lower-case-with-dashes: "truncated", "index-out-of-range", "limit-vertices" */
  char detail[400]; /* one sentence: which file or parameter, what is wrong, what was expected */
};

/* Fills `problem` (NULL: only returns) and returns `status`. Keeps the first problem: a problem already filled is left alone.
 * `type` and the formatted sentence are truncated to fit. */
__attribute__((format(printf, 4, 5))) enum lod_status lod_fail(struct lod_problem *problem, enum lod_status status, const char *type,
                                                               const char *format, ...);

/* LOD_MEMORY with the standard sentence. */
enum lod_status lod_fail_memory(struct lod_problem *problem);

/* "ok", "bad-input", ...: never NULL. */
const char *lod_status_name(enum lod_status status);

#define LOD_WARN_UNUSED __attribute__((warn_unused_result))

#define LOD_TRY(expression)                                                                                                                \
  do {                                                                                                                                     \
    enum lod_status lod_try_status = (expression);                                                                                         \
    if (lod_try_status != LOD_OK)                                                                                                          \
      return lod_try_status;                                                                                                               \
  } while (0)

#endif
