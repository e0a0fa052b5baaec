//! The files of 4DGT's polynomial Gaussians (`docs/spec/baseline-4dgt.md` section 6).

use rogs_arrays::ArrayFile;
use rogs_schemas::records::polynomial::Polynomials;

use crate::outside::OutsideError;

/// Reads the activated parameters, by the names of [`Polynomials`] or by those of 4DGT's own code (`xyz`, `t`, `cov_t`,
/// `ms3`, `omega`, `rotation`, `scaling`, `opacity`, `feature`; of `feature` the first three channels).
///
/// # Errors
/// When an array is missing or has the wrong length.
pub fn read_polynomials(file: &ArrayFile) -> Result<Polynomials, OutsideError> {
    let floats = |names: &[&str]| Ok::<_, OutsideError>(file.need(names)?.into_floats());
    let colours = file.need(&["rgb", "feature"])?;
    let rgb = match colours.shape.last() {
        Some(&width) if width > 3 => {
            let values = colours.into_colours();
            values
                .chunks_exact(width)
                .flat_map(|one| [one[0], one[1], one[2]])
                .collect()
        }
        _ => colours.into_colours(),
    };
    let field = Polynomials {
        centre_m: floats(&["centre_m", "xyz"])?,
        time_s: floats(&["time_s", "t"])?,
        variance_s2: floats(&["variance_s2", "cov_t"])?,
        velocity: floats(&["velocity", "ms3"])?,
        angular: floats(&["angular", "omega"])?,
        rotation: floats(&["rotation"])?,
        scale_m: floats(&["scale_m", "scaling"])?,
        opacity: floats(&["opacity"])?,
        rgb,
    };
    field.check().map_err(|what| OutsideError::file(file.path(), what))?;
    Ok(field)
}
