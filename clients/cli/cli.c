#include "clients/cli/cli.h"

#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

static void print_options(const struct cli_option *options) {
  for (const struct cli_option *o = options; o != NULL && o->name != NULL; o++) {
    char left[64];
    snprintf(left, sizeof left, "%c%c%s --%s%s%s", o->letter ? '-' : ' ', o->letter ? o->letter : ' ', o->letter ? "," : " ", o->name,
             o->argument ? " " : "", o->argument ? o->argument : "");
    printf("  %-28s %s\n", left, o->sentence);
  }
}

static void print_help(const struct cli_command *command) {
  printf("Usage: lodestream %s %s\n\n%s\n", command->name, command->usage, command->sentence);
  if (command->text != NULL)
    printf("\n%s\n", command->text);
  printf("\nOptions:\n");
  print_options(command->options);
  static const struct cli_option kCommon[] = {
      {"json", 0, NULL, "Print facts as one JSON object on standard output."},
      {"help", 'h', NULL, "This text."},
      {"version", 0, NULL, "The version."},
      {0},
  };
  print_options(kCommon);
  printf("\nExit status: 0 done, 1 bad input, 2 wrong usage, 3 a stated limit broken.\n");
}

int cli_usage(const struct cli_command *command, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  fprintf(stderr, "lodestream %s: ", command->name);
  vfprintf(stderr, format, arguments);
  fprintf(stderr, "\nTry: lodestream %s --help\n", command->name);
  va_end(arguments);
  return CLI_USAGE;
}

/* Matches argv[next] against the table: the entry, and where its value stands ("--name=value" or in the next word). */
static const struct cli_option *match(const struct cli_arguments *a, const char *word, const char **attached) {
  *attached = NULL;
  for (const struct cli_option *o = a->command->options; o->name != NULL; o++) {
    size_t length = strlen(o->name);
    if (word[1] == '-' && strncmp(word + 2, o->name, length) == 0 && (word[2 + length] == '\0' || word[2 + length] == '=')) {
      *attached = word[2 + length] == '=' ? word + 3 + length : NULL;
      return o;
    }
    if (word[1] != '-' && o->letter != 0 && word[1] == o->letter) {
      *attached = word[2] != '\0' ? word + 2 : NULL;
      return o;
    }
  }
  return NULL;
}

const struct cli_option *cli_next(struct cli_arguments *a, const char **value) {
  for (; a->next < a->argc; a->next++) {
    const char *word = a->argv[a->next];
    if (word[0] != '-' || word[1] == '\0') {
      if (a->operand_count == (int)(sizeof a->operands / sizeof a->operands[0]))
        exit(cli_usage(a->command, "too many operands"));
      a->operands[a->operand_count++] = word;
      continue;
    }
    if (strcmp(word, "--help") == 0 || strcmp(word, "-h") == 0) {
      print_help(a->command);
      exit(CLI_DONE);
    }
    if (strcmp(word, "--version") == 0) {
      printf("lodestream %s\n", LOD_VERSION);
      exit(CLI_DONE);
    }
    if (strcmp(word, "--json") == 0) {
      a->json = true;
      continue;
    }
    const char *attached;
    const struct cli_option *option = match(a, word, &attached);
    if (option == NULL)
      exit(cli_usage(a->command, "there is no option %s", word));
    a->next++;
    if (option->argument == NULL) {
      if (attached != NULL)
        exit(cli_usage(a->command, "--%s takes no value", option->name));
      return option;
    }
    if (attached == NULL) {
      if (a->next >= a->argc)
        exit(cli_usage(a->command, "--%s needs a value: %s", option->name, option->argument));
      attached = a->argv[a->next++];
    }
    *value = attached;
    return option;
  }
  return NULL;
}

int cli_problem(const struct lod_problem *problem, bool json) {
  if (json) {
    json_t *object =
        json_pack("{s{ss ss ss}}", "problem", "status", lod_status_name(problem->status), "type", problem->type, "detail", problem->detail);
    if (object != NULL) {
      json_dumpf(object, stdout, JSON_COMPACT);
      printf("\n");
      json_decref(object);
    }
  }
  fprintf(stderr, "lodestream: %s [%s]\n", problem->detail, problem->type);
  return problem->status == LOD_LIMIT || problem->status == LOD_MEMORY ? CLI_LIMIT : CLI_BAD_INPUT;
}

bool cli_parse_count(const char *text, uint64_t most, uint64_t *value) {
  char *end;
  errno = 0;
  if (text[0] < '0' || text[0] > '9')
    return false;
  unsigned long long number = strtoull(text, &end, 10);
  if (errno != 0 || *end != '\0' || number > most)
    return false;
  *value = number;
  return true;
}

bool cli_parse_real(const char *text, double *value) {
  char *end;
  errno = 0;
  *value = strtod(text, &end);
  return errno == 0 && end != text && *end == '\0' && isfinite(*value);
}

static enum lod_status read_stdin(struct cli_file *file, struct lod_problem *problem) {
  size_t capacity = 1 << 20, size = 0;
  uint8_t *bytes = malloc(capacity);
  while (bytes != NULL) {
    size_t got = fread(bytes + size, 1, capacity - size, stdin);
    size += got;
    if (size < capacity)
      break;
    capacity *= 2;
    uint8_t *more = realloc(bytes, capacity);
    if (more == NULL)
      free(bytes);
    bytes = more;
  }
  if (bytes == NULL)
    return lod_fail_memory(problem);
  *file = (struct cli_file){bytes, size, false};
  return LOD_OK;
}

enum lod_status cli_file_open(const char *path, struct cli_file *file, struct lod_problem *problem) {
  *file = (struct cli_file){NULL, 0, false};
  if (strcmp(path, "-") == 0)
    return read_stdin(file, problem);
  int fd = open(path, O_RDONLY | O_CLOEXEC);
  struct stat st;
  if (fd < 0 || fstat(fd, &st) != 0) {
    int error = errno;
    if (fd >= 0)
      close(fd);
    return lod_fail(problem, LOD_IO, "cannot-open", "Cannot open %s: %s.", path, strerror(error));
  }
  if (!S_ISREG(st.st_mode)) {
    close(fd);
    return lod_fail(problem, LOD_IO, "cannot-open", "%s is not a regular file.", path);
  }
  if (st.st_size > 0) {
    void *bytes = mmap(NULL, (size_t)st.st_size, PROT_READ, MAP_PRIVATE, fd, 0);
    if (bytes == MAP_FAILED) {
      int error = errno;
      close(fd);
      return lod_fail(problem, LOD_IO, "cannot-open", "Cannot map %s: %s.", path, strerror(error));
    }
    *file = (struct cli_file){bytes, (size_t)st.st_size, true};
  }
  close(fd);
  return LOD_OK;
}

void cli_file_close(struct cli_file *file) {
  if (file->mapped)
    munmap((void *)(uintptr_t)file->bytes, file->size);
  else
    free((void *)(uintptr_t)file->bytes);
  *file = (struct cli_file){NULL, 0, false};
}

enum lod_status cli_import(const char *path, const char *format, struct lod_arena *arena, struct lod_model *model, struct cli_file *file,
                           struct lod_problem *problem) {
  LOD_TRY(cli_file_open(path, file, problem));
  const char *slash = strrchr(path, '/');
  char directory[4096] = ".";
  if (slash != NULL)
    snprintf(directory, sizeof directory, "%.*s", slash == path ? 1 : (int)(slash - path), path);
  int directory_fd = open(directory, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  struct lod_import_files files = lod_import_files_beneath(&directory_fd);
  struct lod_import_request request = {
      .name = slash == NULL ? path : slash + 1,
      .format = format,
      .bytes = file->bytes,
      .size = file->size,
      .files = directory_fd >= 0 ? &files : NULL,
  };
  enum lod_status status = lod_import_model(&request, arena, model, problem);
  if (directory_fd >= 0)
    close(directory_fd);
  if (status != LOD_OK)
    cli_file_close(file);
  return status;
}

const char *cli_bytes(uint64_t bytes, char buffer[32]) {
  static const char *const kUnits[] = {"B", "kB", "MB", "GB", "TB"};
  double value = (double)bytes;
  int unit = 0;
  while (value >= 1000 && unit < 4) {
    value /= 1000;
    unit++;
  }
  snprintf(buffer, 32, unit == 0 ? "%.0f %s" : "%.1f %s", value, kUnits[unit]);
  return buffer;
}

const char *cli_count(uint64_t count, char buffer[32]) {
  char digits[24];
  int length = snprintf(digits, sizeof digits, "%llu", (unsigned long long)count);
  int out = 0;
  for (int i = 0; i < length; i++) {
    if (i > 0 && (length - i) % 3 == 0)
      buffer[out++] = ' ';
    buffer[out++] = digits[i];
  }
  buffer[out] = '\0';
  return buffer;
}

static double now_seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void report(void *context, const char *stage, double fraction) {
  struct cli_bar *bar = context;
  int percent = (int)(100 * fraction);
  if (!bar->shown || percent == bar->last_percent)
    return;
  bar->last_percent = percent;
  static const char kFull[] = "########################################";
  fprintf(stderr, "\r%-10s [%-40.*s] %3d %%  %5.1f s ", stage, percent * 40 / 100, kFull, percent, now_seconds() - bar->started);
  fflush(stderr);
}

struct lod_progress cli_bar_start(struct cli_bar *bar) {
  *bar = (struct cli_bar){.shown = isatty(STDERR_FILENO) == 1, .last_percent = -1, .started = now_seconds()};
  return (struct lod_progress){.report = report, .context = bar};
}

void cli_bar_end(struct cli_bar *bar) {
  if (bar->shown)
    fprintf(stderr, "\r%79s\r", "");
}
