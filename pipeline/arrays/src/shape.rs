//! Shapes that callers ask for.

/// Stands for any length in an expected shape.
pub const ANY: usize = usize::MAX;

/// What is wrong with a shape that should be one of `expected`, if something is.
pub(crate) fn mismatch(found: &[usize], expected: &[&[usize]]) -> Option<String> {
    let fits = |shape: &&[usize]| {
        shape.len() == found.len() && shape.iter().zip(found).all(|(own, found)| *own == ANY || own == found)
    };
    if expected.iter().any(fits) {
        return None;
    }
    let wanted: Vec<String> = expected.iter().map(|shape| text(shape)).collect();
    Some(format!(
        "the shape is {}, expected {}",
        text(found),
        wanted.join(" or ")
    ))
}

fn text(shape: &[usize]) -> String {
    let part = |&length: &usize| {
        if length == ANY {
            "any".to_owned()
        } else {
            length.to_string()
        }
    };
    format!("[{}]", shape.iter().map(part).collect::<Vec<_>>().join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_are_compared_and_named() {
        assert_eq!(mismatch(&[3, 4], &[&[ANY, 4]]), None);
        assert_eq!(mismatch(&[], &[&[]]), None);
        assert_eq!(
            mismatch(&[3, 4], &[&[3], &[ANY, 5]]).unwrap(),
            "the shape is [3, 4], expected [3] or [any, 5]"
        );
    }
}
