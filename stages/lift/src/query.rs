//! Asking a finished field for other times, without the backbone.

use burn::tensor::Device;
use rogs_schemas::records::field::{Field, NamedArray, TimeSlice};
use rogs_stage1::{Encoded, Stage1};
use rogs_tensors::parameters::{from_host, to_host};
use rogs_tensors::{Error, Result};

use crate::lifting::{Anchor, Branch, MotionHeads, MotionOptions};
use crate::source::RobotAtTime;

/// Answers times of one field with the motion heads of the network that made it.
pub struct FieldQuery<'a> {
    field: &'a Field,
    heads: MotionHeads,
    encoded: Encoded,
    options: MotionOptions,
}

impl<'a> FieldQuery<'a> {
    /// Prepares a field for queries.
    ///
    /// # Errors
    /// When the field was written without its query state, or the network is not the one it was made with.
    pub fn new(field: &'a Field, network: &Stage1, options: MotionOptions) -> Result<Self> {
        let encoded = restore(field, network)?;
        Ok(Self {
            field,
            heads: MotionHeads::load(network, field.views.len())?,
            encoded,
            options,
        })
    }

    /// The field at a normalised time in [0, 1]. `robot` holds the conditioning of each source view for that time (an empty
    /// slice feeds zeros, as without FK conditioning). At a stored time with the same conditioning the answer equals the
    /// stored slice.
    ///
    /// # Errors
    /// When the time is outside [0, 1] or the conditioning does not fit the field.
    pub fn at(&self, time: f64, robot: &[Option<RobotAtTime>]) -> Result<TimeSlice> {
        if !(0.0..=1.0).contains(&time) {
            return Err(Error::BadInput(format!(
                "time {time} is outside the clip, which spans 0 to 1"
            )));
        }
        let views = self.field.views.len();
        let none = vec![None; views];
        let robot = if robot.is_empty() { &none } else { robot };
        let area = self.field.height as usize * self.field.width as usize;
        let fits =
            |robot: &RobotAtTime| robot.kappa.len() == rogs_schemas::records::conditioning::KAPPA_CHANNELS * area;
        if robot.len() != views || !robot.iter().flatten().all(fits) {
            return Err(Error::BadInput(format!(
                "the conditioning of a query does not fit the {views} source views of the field"
            )));
        }
        let anchor = Anchor {
            position_m: &self.field.position_m,
            base_raw: &self.field.base_raw,
            link: &self.field.link,
        };
        self.heads
            .slice(&self.encoded, &anchor, time, self.options, robot, Branch::Maps)
    }
}

/// What the motion heads need, as it is kept in a field.
pub(crate) fn keep(encoded: &Encoded) -> Result<Vec<NamedArray>> {
    let keep = |(index, tap): (usize, &burn::tensor::Tensor<3>)| {
        let shape = tap.dims().map(|size| size as u32).to_vec();
        Ok(NamedArray {
            name: format!("tap{index}"),
            shape,
            data: to_host(tap.clone())?,
        })
    };
    encoded.taps.iter().enumerate().map(keep).collect()
}

/// The inverse of [`keep`].
fn restore(field: &Field, network: &Stage1) -> Result<Encoded> {
    let device: &Device = network.parameters.device();
    let size = [field.height as usize, field.width as usize];
    let grid = network.config.grid(size[0], size[1])?;
    let shape = [field.views.len(), grid[0] * grid[1], 2 * network.config.width];
    let tap = |index: usize| {
        let name = format!("tap{index}");
        let array = field.query_state.iter().find(|array| array.name == name).ok_or_else(|| {
            Error::BadInput("the field was written without its query state (`query_state = \"drop\"`); lift it again with \"keep\"".into())
        })?;
        if array.shape.iter().map(|&size| size as usize).ne(shape)
            || array.data.len() != shape.iter().product::<usize>()
        {
            return Err(Error::BadInput(format!(
                "the query state of the field is {:?}, the network needs {shape:?}",
                array.shape
            )));
        }
        Ok(from_host(array.data.clone(), shape, device))
    };
    Ok(Encoded {
        taps: [tap(0)?, tap(1)?, tap(2)?, tap(3)?],
        local: None,
        grid,
        size,
    })
}
