//! `trajectory.h5`.

use hdf5_writer::{
    AttributeBuilder, ByteOrder, DatasetBuilder, Datatype, EnumMember, FILTER_DEFLATE, FilterDescription, Hdf5Builder,
    WriteOptions,
};

use super::{DroidEpisode, Peculiar, native_lens, six};
use crate::cameras::Mount;
use crate::error::{Error, Result};
use crate::robot::ARM_JOINTS;

/// When an episode begins, milliseconds since 1970.
const BEGIN_MS: f64 = 1_688_726_543_000.0;
/// Rows of a packed chunk.
const CHUNK: u64 = 16;

/// Data sets that were named so far.
struct Tables(Vec<DatasetBuilder>);

impl Tables {
    /// Numbers of `[rows, columns...]`, packed.
    fn numbers(&mut self, name: String, shape: &[usize], values: &[f64]) -> Result<()> {
        let shape: Vec<u64> = shape.iter().map(|&length| length as u64).collect();
        let mut chunk = shape.clone();
        chunk[0] = chunk[0].min(CHUNK);
        let packed = FilterDescription {
            id: FILTER_DEFLATE,
            name: None,
            client_data: vec![4],
        };
        let table = DatasetBuilder::typed_data(name, shape, values).map_err(Error::hdf5)?;
        self.0.push(table.chunked(chunk).filter(packed));
        Ok(())
    }

    fn whole(&mut self, name: String, values: &[i64]) -> Result<()> {
        let table = DatasetBuilder::typed_data(name, vec![values.len() as u64], values);
        self.0.push(table.map_err(Error::hdf5)?);
        Ok(())
    }

    /// Truth values as h5py stores them.
    fn truths(&mut self, name: &str, values: &[bool]) {
        let member = |name: &str, value: u8| EnumMember {
            name: name.to_owned(),
            value: vec![value],
        };
        let base = Datatype::FixedPoint {
            size: 1,
            signed: true,
            byte_order: ByteOrder::LittleEndian,
        };
        let datatype = Datatype::Enum {
            base: Box::new(base),
            members: vec![member("FALSE", 0), member("TRUE", 1)],
        };
        let bytes: Vec<u8> = values.iter().map(|&value| u8::from(value)).collect();
        self.0
            .push(DatasetBuilder::new(name, datatype, vec![values.len() as u64]).raw_data(bytes));
    }
}

/// The bytes of the file.
pub(super) fn encode(episode: &DroidEpisode) -> Result<Vec<u8>> {
    let truth = &episode.truth;
    let rows: Vec<usize> = (0..truth.frame_count()).map(|row| episode.state_of_row(row)).collect();
    let steps = rows.len();
    let mut tables = Tables(Vec::new());
    let joints: Vec<f64> = rows.iter().flat_map(|&row| truth.states[row].joints).collect();
    let gripper: Vec<f64> = rows.iter().map(|&row| truth.states[row].gripper).collect();
    let flange: Vec<f64> = rows.iter().flat_map(|&row| six(&truth.base_from_flange(row))).collect();
    for group in ["observation/robot_state", "action"] {
        let joint = if group == "action" {
            "joint_position"
        } else {
            "joint_positions"
        };
        tables.numbers(format!("{group}/{joint}"), &[steps, ARM_JOINTS], &joints)?;
        tables.numbers(format!("{group}/gripper_position"), &[steps], &gripper)?;
        tables.numbers(format!("{group}/cartesian_position"), &[steps, 6], &flange)?;
    }
    times(&mut tables, episode, steps)?;
    let idle = |row: usize| episode.peculiar == Peculiar::Late && (3..5).contains(&row);
    let moved: Vec<bool> = (0..steps).map(|row| !idle(row)).collect();
    tables.truths("observation/controller_info/movement_enabled", &moved);
    tables.truths("observation/timestamp/skip_action", &vec![false; steps]);
    for (camera, serial) in episode.serials.into_iter().enumerate() {
        cameras(&mut tables, episode, (camera, serial), &rows)?;
    }
    let mut file = Hdf5Builder::new();
    for table in tables.0 {
        file = file.dataset(table);
    }
    let attributes = [
        ("current_task", truth.task()),
        ("user", "synth".to_owned()),
        ("version_number", "1.3".to_owned()),
    ];
    for (name, value) in attributes {
        file = file.attribute(AttributeBuilder::fixed_string(name, value));
    }
    let plan = file.into_plan().map_err(Error::hdf5)?;
    plan.encode(WriteOptions::default()).map_err(Error::hdf5)
}

/// Robot and cameras are read one after the other; the clock counts whole milliseconds.
fn times(tables: &mut Tables, episode: &DroidEpisode, steps: usize) -> Result<()> {
    let step_ms = 1000.0 / episode.truth.config.fps;
    let every = |offset: f64| -> Vec<i64> {
        (0..steps)
            .map(|row| (BEGIN_MS + row as f64 * step_ms + offset).round() as i64)
            .collect()
    };
    let late = -(episode.late() as f64) * step_ms;
    let robot = "observation/timestamp/robot_state";
    tables.whole(format!("{robot}/read_start"), &every(late - 4.0))?;
    tables.whole(format!("{robot}/read_end"), &every(late + 4.0))?;
    for (serial, offset) in episode.serials.into_iter().zip([0.0, 3.0, 7.0]) {
        let camera = format!("observation/timestamp/cameras/{serial}");
        tables.whole(format!("{camera}_read_start"), &every(offset + 10.0))?;
        tables.whole(format!("{camera}_read_end"), &every(offset + 20.0))?;
        tables.whole(format!("{camera}_frame_received"), &every(offset + 15.0))?;
        tables.whole(format!("{camera}_estimated_capture"), &every(offset))?;
    }
    Ok(())
}

fn cameras(tables: &mut Tables, episode: &DroidEpisode, (camera, serial): (usize, &str), rows: &[usize]) -> Result<()> {
    let (truth, steps) = (&episode.truth, rows.len());
    let pose = |eye: usize| -> Vec<f64> {
        rows.iter()
            .flat_map(|&row| six(&truth.base_from_camera(camera + eye, row)))
            .collect()
    };
    let at = format!("observation/camera_extrinsics/{serial}");
    tables.numbers(format!("{at}_left"), &[steps, 6], &pose(0))?;
    tables.numbers(format!("{at}_right"), &[steps, 6], &pose(3))?;
    if let Mount::Flange(hand_eye) = truth.cameras[camera].mount {
        let offsets: Vec<f64> = (0..steps).flat_map(|_| six(&hand_eye)).collect();
        tables.numbers(format!("{at}_left_gripper_offset"), &[steps, 6], &offsets)?;
    }
    tables.whole(
        format!("observation/camera_type/{serial}"),
        &vec![i64::from(camera != 0); steps],
    )?;
    let lens = native_lens(&truth.cameras[camera]);
    let matrix = match episode.peculiar {
        Peculiar::Late => return Ok(()),
        Peculiar::ZeroIntrinsics => [0.0; 9],
        _ => [lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0],
    };
    let matrices: Vec<f64> = (0..steps).flat_map(|_| matrix).collect();
    tables.numbers(
        format!("observation/camera_intrinsics/{serial}_left"),
        &[steps, 3, 3],
        &matrices,
    )
}
