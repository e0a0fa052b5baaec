//! What the settings of wide worlds may be.

use super::World;
use crate::error::{Error, Result};

const SHARE: &str = "a share from 0 to 1";
const ANGLE: &str = "ascending, from 20 to 130";

impl World {
    /// Checks every setting.
    ///
    /// # Errors
    /// [`Error::Config`] that names the setting and its range.
    pub fn check(&self) -> Result<()> {
        let unit = [0.0, 1.0];
        number("world.share", self.share, unit, SHARE)?;
        number("world.look_away", self.look_away, unit, SHARE)?;
        number("world.photos", self.photos, unit, SHARE)?;
        number("world.models", self.models, unit, SHARE)?;
        number("world.probes", self.probes, unit, SHARE)?;
        number("world.arms", self.arms, unit, SHARE)?;
        let weights = self.layouts.weights().map(|(_, weight)| weight);
        if weights.iter().any(|weight| !(0.0..=1e6).contains(weight)) || weights.iter().sum::<f64>() <= 0.0 {
            let value = format!("{weights:?}");
            return wrong("world.layouts", value, "not negative, one of them positive");
        }
        self.check_places()?;
        self.check_sensor()?;
        self.check_calibration()
    }

    fn check_places(&self) -> Result<()> {
        let angles = [20.0, 130.0];
        range("world.field_of_view_deg", self.field_of_view_deg, angles, ANGLE)?;
        range(
            "world.wrist_field_of_view_deg",
            self.wrist_field_of_view_deg,
            angles,
            ANGLE,
        )?;
        let rule = "ascending, from 0.3 to 4";
        range("world.distance_m", self.distance_m, [0.3, 4.0], rule)?;
        let rule = "ascending, from 0.02 to 2";
        range("world.baseline_m", self.baseline_m, [0.02, 2.0], rule)?;
        let rule = "ascending, from 0.5 to 10";
        range("world.base_distance_m", self.base_distance_m, [0.5, 10.0], rule)?;
        let rule = "ascending, from 0.2 to 2";
        range("world.room_scale", self.room_scale, [0.2, 2.0], rule)?;
        range("world.room_m", self.room_m, [2.0, 20.0], "ascending, from 2 to 20")?;
        let rule = "ascending, from 0 to 1.5";
        range("world.base_height_m", self.base_height_m, [0.0, 1.5], rule)?;
        let rule = "ascending, from -0.25 to 0.15";
        range("world.table_height_m", self.table_height_m, [-0.25, 0.15], rule)?;
        let rule = "ascending, from 0 to 8";
        range("world.table_tilt_deg", self.table_tilt_deg, [0.0, 8.0], rule)?;
        let counts = [
            ("world.furniture", self.furniture, 60, "ascending, at most 60"),
            ("world.clutter", self.clutter, 40, "ascending, at most 40"),
        ];
        for (what, [fewest, most], largest, rule) in counts {
            if fewest > most || most > largest {
                return wrong(what, format!("{fewest} to {most}"), rule);
            }
        }
        Ok(())
    }

    fn check_sensor(&self) -> Result<()> {
        let sensor = &self.sensor;
        let rule = "ascending, from 0.05 to 8";
        range("world.sensor.exposure", sensor.exposure, [0.05, 8.0], rule)?;
        number("world.sensor.balance", sensor.balance, [0.0, 0.6], "from 0 to 0.6")?;
        let rule = "ascending, from 0.3 to 3";
        range("world.sensor.contrast", sensor.contrast, [0.3, 3.0], rule)?;
        let rule = "ascending, from 0 to 0.9";
        range("world.sensor.vignette", sensor.vignette, [0.0, 0.9], rule)?;
        range(
            "world.sensor.noise",
            sensor.noise,
            [0.0, 40.0],
            "ascending, from 0 to 40",
        )?;
        range("world.sensor.blur", sensor.blur, [0.0, 30.0], "ascending, from 0 to 30")?;
        number("world.sensor.compressed", sensor.compressed, [0.0, 1.0], SHARE)?;
        let rule = "ascending, from 1 to 100";
        range("world.sensor.quality", sensor.quality, [1.0, 100.0], rule)
    }

    fn check_calibration(&self) -> Result<()> {
        let calibration = &self.calibration;
        let (metres, degrees) = ("from 0 to 0.1", "from 0 to 10");
        number("world.calibration.share", calibration.share, [0.0, 1.0], SHARE)?;
        number(
            "world.calibration.external_m",
            calibration.external_m,
            [0.0, 0.1],
            metres,
        )?;
        number(
            "world.calibration.external_deg",
            calibration.external_deg,
            [0.0, 10.0],
            degrees,
        )?;
        number("world.calibration.wrist_m", calibration.wrist_m, [0.0, 0.1], metres)?;
        number(
            "world.calibration.wrist_deg",
            calibration.wrist_deg,
            [0.0, 10.0],
            degrees,
        )?;
        number(
            "world.calibration.focal",
            calibration.focal,
            [0.0, 0.2],
            "from 0 to 0.2",
        )
    }
}

fn wrong(what: &'static str, value: String, rule: &'static str) -> Result<()> {
    Err(Error::Config { what, value, rule })
}

fn number(what: &'static str, value: f64, [least, most]: [f64; 2], rule: &'static str) -> Result<()> {
    if (least..=most).contains(&value) {
        Ok(())
    } else {
        wrong(what, value.to_string(), rule)
    }
}

fn range(what: &'static str, [low, high]: [f64; 2], [least, most]: [f64; 2], rule: &'static str) -> Result<()> {
    if (least..=most).contains(&low) && (low..=most).contains(&high) {
        Ok(())
    } else {
        wrong(what, format!("{low} to {high}"), rule)
    }
}
