// The nearest return of all scanners, and how many scans there were: a compiled feature plugin.
#include <cmath>
#include <cstdlib>

#include "oracle_plugin.h"

namespace {

constexpr int kFeatures = 2;
const char* const kNames[kFeatures] = {"nearest", "scans"};

const char kDescription[] = R"({
  "name": "compiled_clearance",
  "family": "compiled",
  "features": [
    {"name": "nearest", "unit": "m", "floor": 0.02, "description": "nearest return of all scanners"},
    {"name": "scans", "unit": "1", "floor": 1, "description": "scans of all scanners"}
  ],
  "topics": {"scans": {"role": "scan", "fields": ["ranges", "range_min"]}}
})";

// What the feature table is made of; release frees it.
struct Table {
  ArrowSchema schemas[kFeatures];
  ArrowSchema* schema_children[kFeatures];
  ArrowArray arrays[kFeatures];
  ArrowArray* array_children[kFeatures];
  const void* buffers[kFeatures][2];
  const void* no_nulls[1];
  double values[kFeatures];
};

void release_child(ArrowSchema* schema) { schema->release = nullptr; }
void release_child(ArrowArray* array) { array->release = nullptr; }

// Schema and array may be released in any order, so each owns a table.
template <typename Part>
void release(Part* part) {
  for (int64_t n = 0; n < part->n_children; ++n) {
    if (part->children[n]->release) part->children[n]->release(part->children[n]);
  }
  std::free(part->private_data);
  part->release = nullptr;
}

Table* make_table() { return static_cast<Table*>(std::calloc(1, sizeof(Table))); }

bool write_schema(ArrowSchema* schema) {
  Table* table = make_table();
  if (!table) return false;
  *schema = ArrowSchema{};
  for (int n = 0; n < kFeatures; ++n) {
    table->schemas[n].format = "g";  // float64
    table->schemas[n].name = kNames[n];
    table->schemas[n].flags = 2;  // nullable
    table->schemas[n].release = release_child;
    table->schema_children[n] = &table->schemas[n];
  }
  schema->format = "+s";  // struct
  schema->name = "";
  schema->n_children = kFeatures;
  schema->children = table->schema_children;
  schema->release = release<ArrowSchema>;
  schema->private_data = table;
  return true;
}

bool write_array(const double (&values)[kFeatures], ArrowArray* array) {
  Table* table = make_table();
  if (!table) return false;
  *array = ArrowArray{};
  for (int n = 0; n < kFeatures; ++n) {
    table->values[n] = values[n];
    table->buffers[n][1] = &table->values[n];
    table->arrays[n].length = 1;
    table->arrays[n].n_buffers = 2;
    table->arrays[n].buffers = table->buffers[n];
    table->arrays[n].release = release_child;
    table->array_children[n] = &table->arrays[n];
  }
  array->length = 1;
  array->n_buffers = 1;
  array->buffers = table->no_nulls;
  array->n_children = kFeatures;
  array->children = table->array_children;
  array->release = release<ArrowArray>;
  array->private_data = table;
  return true;
}

int32_t compute(const OracleWindow* window, ArrowSchema* schema, ArrowArray* array, char*, size_t) {
  const ArrowArray& scans = *window->tables[0].array;  // topic, time_s, ranges, range_min
  const ArrowArray& ranges = *scans.children[2];
  const auto* ends = static_cast<const int32_t*>(ranges.buffers[1]) + ranges.offset;
  const auto* all = static_cast<const double*>(ranges.children[0]->buffers[1]);
  const auto* nearest_valid = static_cast<const double*>(scans.children[3]->buffers[1]);
  double nearest = INFINITY;
  for (int64_t scan = 0; scan < scans.length; ++scan) {
    for (int32_t ray = ends[scan]; ray < ends[scan + 1]; ++ray) {
      if (all[ray] >= nearest_valid[scan] && all[ray] < nearest) nearest = all[ray];
    }
  }
  const double values[kFeatures] = {std::isinf(nearest) ? NAN : nearest, double(scans.length)};
  if (!write_schema(schema)) return 1;
  if (write_array(values, array)) return 0;
  schema->release(schema);
  return 1;
}

const OraclePluginV1 kPlugin = {kDescription, compute};

}  // namespace

const OraclePluginV1* oracle_plugin_v1() { return &kPlugin; }
