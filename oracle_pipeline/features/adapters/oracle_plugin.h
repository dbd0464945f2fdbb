/* Feature plugins as shared libraries, version 1. Copy this file into your project.
 *
 * A library exports one function, oracle_plugin_v1, which returns what is known of the plugin and
 * how to call it. Tables pass through the Arrow C data interface
 * (https://arrow.apache.org/docs/format/CDataInterface.html), without copies and without linking
 * to Arrow. docs/how-to/compiled-plugins.md says what is in them.
 */
#ifndef BEHAVIOUR_ORACLE_PLUGIN_H
#define BEHAVIOUR_ORACLE_PLUGIN_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifndef ARROW_C_DATA_INTERFACE
#define ARROW_C_DATA_INTERFACE

struct ArrowSchema {
  const char* format;
  const char* name;
  const char* metadata;
  int64_t flags;
  int64_t n_children;
  struct ArrowSchema** children;
  struct ArrowSchema* dictionary;
  void (*release)(struct ArrowSchema*);
  void* private_data;
};

struct ArrowArray {
  int64_t length;
  int64_t null_count;
  int64_t offset;
  int64_t n_buffers;
  int64_t n_children;
  const void** buffers;
  struct ArrowArray** children;
  struct ArrowArray* dictionary;
  void (*release)(struct ArrowArray*);
  void* private_data;
};

#endif /* ARROW_C_DATA_INTERFACE */

/* One requested table: the messages of its topics in the window, in order of topic, then time.
 * A struct array; its columns are "topic" (utf8), "time_s" (float64, since the start of the
 * recording), and one for each requested field: float64, or list<float64> for an array. All
 * offsets are 0, and nothing is null. */
struct OracleTable {
  const char* name; /* of the request */
  const struct ArrowSchema* schema;
  const struct ArrowArray* array;
};

struct OracleWindow {
  double start_s; /* since the start of the recording */
  double end_s;
  int64_t n_tables;
  const struct OracleTable* tables; /* in the order of the description; the host's: do not release */
};

struct OraclePluginV1 {
  /* JSON: {"name": ..., "family": ..., "features": [{"name", "unit", "floor", "description"}],
   *        "topics": {request: {"role" or "msgtype" or "topic": ..., "fields": [...]}}} */
  const char* description;
  /* Write a struct array of one row with a float64 column for each feature, in the order of the
   * description, into schema and array; null or NaN: missing. The host calls their release.
   * Return 0; or another number, with the reason in error (UTF-8, at most size bytes). */
  int32_t (*compute)(const struct OracleWindow* window, struct ArrowSchema* schema,
                     struct ArrowArray* array, char* error, size_t size);
};

#if defined(_WIN32)
#define BEHAVIOUR_ORACLE_EXPORT __declspec(dllexport)
#else
#define BEHAVIOUR_ORACLE_EXPORT __attribute__((visibility("default")))
#endif

/* The one function that a plugin exports. It and what it returns live as long as the library. */
BEHAVIOUR_ORACLE_EXPORT const struct OraclePluginV1* oracle_plugin_v1(void);

#ifdef __cplusplus
}
#endif

#endif /* BEHAVIOUR_ORACLE_PLUGIN_H */
