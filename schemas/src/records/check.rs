//! Checks shared by the records and by whoever reads them from files; each returns what is wrong, in words.

use crate::index::FrameIndex;

/// Result of a check.
pub type Check = Result<(), String>;

/// Largest image side, pixels.
const MAX_SIDE: u32 = 16_384;

/// A number of things that must agree.
///
/// # Errors
/// When they differ.
pub fn count(what: &str, found: usize, expected: usize) -> Check {
    if found == expected {
        Ok(())
    } else {
        Err(format!("{what} has {found} values, expected {expected}"))
    }
}

/// A condition with its message.
///
/// # Errors
/// The message, when it does not hold.
pub fn ensure(condition: bool, message: impl FnOnce() -> String) -> Check {
    if condition { Ok(()) } else { Err(message()) }
}

/// Image sides between 1 and a generous limit; returns the number of pixels.
///
/// # Errors
/// When a side is 0 or beyond the limit.
pub fn area(height: u32, width: u32) -> Result<usize, String> {
    let fits = |side: u32| (1..=MAX_SIDE).contains(&side);
    ensure(fits(height) && fits(width), || {
        format!("an image of {width}x{height} pixels is impossible")
    })?;
    Ok(height as usize * width as usize)
}

/// Clip frames: strictly ascending and below the frame count.
///
/// # Errors
/// When they do not.
pub fn ascending_frames(what: &str, frames: &[FrameIndex], frame_count: usize) -> Check {
    let sorted = frames.is_sorted_by(|a, b| a < b);
    ensure(
        sorted && frames.last().is_none_or(|last| last.at() < frame_count),
        || format!("{what} {frames:?} do not ascend below {frame_count}"),
    )
}

/// Finite numbers.
///
/// # Errors
/// The first that is not.
pub fn finite(what: &str, values: &[f64]) -> Check {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(index) => Err(format!("{what} is {} at index {index}", values[index])),
    }
}

/// Bytes that are 0 or 1.
///
/// # Errors
/// The first that is neither.
pub fn binary(what: &str, values: &[u8]) -> Check {
    match values.iter().position(|&value| value > 1) {
        None => Ok(()),
        Some(index) => Err(format!("{what} is {} at index {index}, expected 0 or 1", values[index])),
    }
}

/// A product of counts from a file; an error instead of an overflow.
///
/// # Errors
/// When it overflows.
pub fn product(what: &str, factors: &[usize]) -> Result<usize, String> {
    let product = factors
        .iter()
        .try_fold(1usize, |product, &factor| product.checked_mul(factor));
    product.ok_or_else(|| format!("{what}: the counts {factors:?} are too large"))
}

/// A finite pose.
///
/// # Errors
/// The first number that is not finite.
pub fn pose(what: &str, pose: &crate::pose::RigidPose) -> Check {
    finite(what, &pose.rotation)?;
    finite(what, &pose.translation)
}

/// How many flags are set.
#[must_use]
pub fn nonzero(flags: &[u8]) -> usize {
    flags.iter().filter(|&&flag| flag != 0).count()
}
