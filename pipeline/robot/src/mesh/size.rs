//! Sizes of meshes against the size of their robot: numbers in millimetres show.

use super::Mesh;
use crate::model::RobotModel;

/// The largest mesh of a robot over the reach of its joints, as robots are built: from a finger to a base plate.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 0.02..=20.0;

/// Compares the meshes of a robot with how far its joints lie apart.
#[derive(Debug)]
pub struct Sizes {
    reach_m: f64,
    /// What it is, whether it comes from a file, and its largest extent, metres.
    largest: Option<(String, bool, f64)>,
}

impl Sizes {
    /// For a robot at joint values of 0.
    #[must_use]
    pub fn new(model: &RobotModel) -> Self {
        let origins = model.joint_state([]).map(|state| model.fk(&state)).unwrap_or_default();
        let reach = origins.iter().map(|pose| pose.translation.length()).fold(0.0, f64::max);
        Self {
            reach_m: reach,
            largest: None,
        }
    }

    /// Takes a mesh in the frame of its link into account, by its name for people and whether it comes from a file.
    pub fn add(&mut self, name: String, of_file: bool, mesh: &Mesh) {
        let mut bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
        for position in &mesh.positions {
            for axis in 0..3 {
                bounds[0][axis] = bounds[0][axis].min(position[axis]);
                bounds[1][axis] = bounds[1][axis].max(position[axis]);
            }
        }
        let extent = (0..3)
            .map(|axis| f64::from(bounds[1][axis] - bounds[0][axis]))
            .fold(0.0, f64::max);
        if self.largest.as_ref().is_none_or(|(.., largest)| extent > *largest) {
            self.largest = Some((name, of_file, extent));
        }
    }

    /// A line for people where the largest mesh is out of proportion.
    #[must_use]
    pub fn note(&self) -> Option<String> {
        let (name, of_file, extent) = self.largest.as_ref()?;
        // Robots with all joints in one place tell nothing.
        if self.reach_m < 1e-3 || PLAUSIBLE.contains(&(extent / self.reach_m)) {
            return None;
        }
        let (what, remedy) = match (*extent > self.reach_m, of_file) {
            (true, true) => (
                "its numbers look like millimetres (or centimetres)",
                "the URDF scales such meshes by scale=\"0.001 0.001 0.001\" (0.01 for centimetres)",
            ),
            (false, true) => (
                "it looks some 100 to 1000 times too small",
                "is a `scale` in the URDF there too much, or the `unit` of the file wrong?",
            ),
            (true, false) => (
                "its numbers look like millimetres (or centimetres)",
                "URDF takes metres",
            ),
            (false, false) => ("it looks some 100 to 1000 times too small", "URDF takes metres"),
        };
        Some(format!(
            "{name} is {extent:.4} m large, and the joints of the robot lie within {:.3} m: {what}; {remedy}",
            self.reach_m
        ))
    }
}
