//! The nearest return of all scanners, and how many scans there were: a plugin without crates.
//!
//! The structs are those of `oracle_plugin.h`. Build it with
//! `rustc --edition 2021 -O --crate-type cdylib clearance.rs -o clearance_rust.so`.

use std::ffi::{c_char, c_void, CStr};
use std::ptr::{null, null_mut};
use std::slice::from_raw_parts;

const NAMES: [&CStr; 2] = [c"nearest", c"scans"];
const DESCRIPTION: &CStr = cr#"{
  "name": "rust_clearance",
  "family": "rust",
  "features": [
    {"name": "nearest", "unit": "m", "floor": 0.02, "description": "nearest return of all scanners"},
    {"name": "scans", "unit": "1", "floor": 1, "description": "scans of all scanners"}
  ],
  "topics": {"scans": {"role": "scan", "fields": ["ranges", "range_min"]}}
}"#;

#[repr(C)]
pub struct ArrowSchema {
    format: *const c_char,
    name: *const c_char,
    metadata: *const c_char,
    flags: i64,
    n_children: i64,
    children: *mut *mut ArrowSchema,
    dictionary: *mut ArrowSchema,
    release: Option<unsafe extern "C" fn(*mut ArrowSchema)>,
    private_data: *mut c_void,
}

#[repr(C)]
pub struct ArrowArray {
    length: i64,
    null_count: i64,
    offset: i64,
    n_buffers: i64,
    n_children: i64,
    buffers: *const *const c_void,
    children: *mut *mut ArrowArray,
    dictionary: *mut ArrowArray,
    release: Option<unsafe extern "C" fn(*mut ArrowArray)>,
    private_data: *mut c_void,
}

#[repr(C)]
pub struct OracleTable {
    name: *const c_char,
    schema: *const ArrowSchema,
    array: *const ArrowArray,
}

#[repr(C)]
pub struct OracleWindow {
    start_s: f64,
    end_s: f64,
    n_tables: i64,
    tables: *const OracleTable,
}

type Compute = unsafe extern "C" fn(
    *const OracleWindow, *mut ArrowSchema, *mut ArrowArray, *mut c_char, usize,
) -> i32;

#[repr(C)]
pub struct OraclePluginV1 {
    description: *const c_char,
    compute: Compute,
}

unsafe impl Sync for OraclePluginV1 {} // it only points to constants

static PLUGIN: OraclePluginV1 = OraclePluginV1 { description: DESCRIPTION.as_ptr(), compute };

#[no_mangle]
pub extern "C" fn oracle_plugin_v1() -> *const OraclePluginV1 {
    &PLUGIN
}

/// The column numbers of the table: topic, time_s, and the fields that the description asks for.
const RANGES: usize = 2;
const RANGE_MIN: usize = 3;

unsafe extern "C" fn compute(
    window: *const OracleWindow, schema: *mut ArrowSchema, array: *mut ArrowArray,
    _error: *mut c_char, _size: usize,
) -> i32 {
    let scans = &*(*(*window).tables).array;
    let mut nearest = f64::INFINITY;
    if scans.length > 0 {
        let count = scans.length as usize;
        let columns = from_raw_parts(scans.children, scans.n_children as usize);
        let ranges = &*columns[RANGES];
        let ends: &[i32] = from_raw_parts(buffer(ranges), count + 1);
        let all: *const f64 = buffer(&**ranges.children);
        let least: &[f64] = from_raw_parts(buffer(&*columns[RANGE_MIN]), count);
        for (part, least) in ends.windows(2).zip(least) {
            for ray in part[0]..part[1] {
                let range = *all.add(ray as usize);
                if range >= *least && range < nearest {
                    nearest = range;
                }
            }
        }
    }
    let values = [if nearest.is_finite() { nearest } else { f64::NAN }, scans.length as f64];
    *schema = struct_schema();
    *array = struct_array(values);
    0
}

/// The values of a column, or the offsets of a list; offsets of columns are always 0.
unsafe fn buffer<T>(column: &ArrowArray) -> *const T {
    (*column.buffers.add(1)).cast()
}

fn schema_of(format: &'static CStr, name: &'static CStr) -> ArrowSchema {
    ArrowSchema {
        format: format.as_ptr(), name: name.as_ptr(), metadata: null(), flags: 2, // nullable
        n_children: 0, children: null_mut(), dictionary: null_mut(),
        release: Some(release_schema), private_data: null_mut(),
    }
}

fn array_of(n_buffers: i64, buffers: Vec<*const c_void>) -> ArrowArray {
    ArrowArray {
        length: 1, null_count: 0, offset: 0, n_buffers, n_children: 0,
        buffers: Box::leak(buffers.into_boxed_slice()).as_ptr(), children: null_mut(),
        dictionary: null_mut(), release: Some(release_array), private_data: null_mut(),
    }
}

fn struct_schema() -> ArrowSchema {
    let columns = NAMES.map(|name| Box::into_raw(Box::new(schema_of(c"g", name))));
    let mut schema = schema_of(c"+s", c"");
    schema.n_children = columns.len() as i64;
    schema.children = Box::into_raw(Box::new(columns)).cast();
    schema
}

fn struct_array(values: [f64; 2]) -> ArrowArray {
    let columns = values.map(|value| {
        let value = Box::into_raw(Box::new(value));
        let mut column = array_of(2, vec![null(), value.cast_const().cast()]);
        column.private_data = value.cast();
        Box::into_raw(Box::new(column))
    });
    let mut array = array_of(1, vec![null()]);
    array.n_children = columns.len() as i64;
    array.children = Box::into_raw(Box::new(columns)).cast();
    array
}

unsafe extern "C" fn release_schema(schema: *mut ArrowSchema) {
    let schema = &mut *schema;
    if schema.n_children > 0 {
        let columns: Box<[*mut ArrowSchema; 2]> = Box::from_raw(schema.children.cast());
        for column in *columns {
            if let Some(release) = (*column).release {
                release(column);
            }
            drop(Box::from_raw(column));
        }
    }
    schema.release = None;
}

unsafe extern "C" fn release_array(array: *mut ArrowArray) {
    let array = &mut *array;
    if array.n_children > 0 {
        let columns: Box<[*mut ArrowArray; 2]> = Box::from_raw(array.children.cast());
        for column in *columns {
            if let Some(release) = (*column).release {
                release(column);
            }
            drop(Box::from_raw(column));
        }
    }
    if !array.private_data.is_null() {
        drop(Box::<f64>::from_raw(array.private_data.cast()));
    }
    let buffers = std::ptr::slice_from_raw_parts_mut(
        array.buffers.cast_mut(), array.n_buffers as usize,
    );
    drop(Box::from_raw(buffers));
    array.release = None;
}
