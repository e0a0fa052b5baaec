//! Which joints leave their limits, over many states, and which mistake that may be.

use crate::model::{JointKind, JointState, RobotModel};

/// What is known of the states seen so far.
#[derive(Debug)]
pub struct LimitTally<'a> {
    model: &'a RobotModel,
    /// By joint: how many states are beyond its limits, and the value that is farthest.
    beyond: Vec<(usize, f64)>,
    states: usize,
}

impl<'a> LimitTally<'a> {
    /// No states yet.
    #[must_use]
    pub fn new(model: &'a RobotModel) -> Self {
        Self {
            model,
            beyond: vec![(0, 0.0); model.joints.len()],
            states: 0,
        }
    }

    /// Counts a state.
    pub fn add(&mut self, state: &JointState) {
        self.states += 1;
        for excess in self.model.limit_excesses(state) {
            let [lower, upper] = excess.limits;
            let far = |value: f64| (lower - value).max(value - upper);
            let (count, worst) = &mut self.beyond[excess.joint];
            if *count == 0 || far(excess.value) > far(*worst) {
                *worst = excess.value;
            }
            *count += 1;
        }
    }

    /// One warning for each joint that leaves its limits, with the number of states, called `what`; `degrees` says what to do
    /// about values in degrees.
    #[must_use]
    pub fn warnings(&self, what: &str, degrees: &str) -> Vec<String> {
        let warning = |(joint, &(count, worst)): (usize, &(usize, f64))| {
            let joint = &self.model.joints[joint];
            let [lower, upper] = joint.limits.filter(|_| count > 0)?;
            // The farther limit, seen from 0: values of that many times its size have another unit.
            let farther = lower.abs().max(upper.abs());
            let question = if worst.abs() > 7.0 && joint.kind == JointKind::Rotational {
                format!("; are the values degrees instead of radians ({degrees})?")
            } else if worst.abs() > 20.0 * farther && farther > 0.0 && joint.kind == JointKind::Linear {
                "; are the values millimetres instead of metres?".to_owned()
            } else if count == self.states {
                "; is the order of the joints right?".to_owned()
            } else {
                String::new()
            };
            Some(format!(
                "joint `{}` leaves its limits [{lower}, {upper}] in {count} of {} {what} (worst value {worst:.4}){question}",
                joint.name, self.states
            ))
        };
        self.beyond.iter().enumerate().filter_map(warning).collect()
    }
}
