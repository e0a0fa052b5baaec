//! Which camera, which frame: numbers that count different things have different types.
//!
//! In files, JSON and parameters they are plain numbers.

use std::fmt;
use std::num::ParseIntError;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

macro_rules! index {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
        #[serde(transparent)]
        pub struct $name(pub u32);

        impl $name {
            /// The place in an array that has one entry for each.
            #[must_use]
            pub const fn at(self) -> usize {
                self.0 as usize
            }

            /// The first so many.
            pub fn first(count: usize) -> impl DoubleEndedIterator<Item = Self> + ExactSizeIterator + Clone {
                (0..count).map(|index| Self(index as u32))
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Display::fmt(&self.0, f)
            }
        }

        /// The number alone, so that lists of them read well in messages.
        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Debug::fmt(&self.0, f)
            }
        }

        impl FromStr for $name {
            type Err = ParseIntError;

            fn from_str(text: &str) -> Result<Self, ParseIntError> {
                text.parse().map(Self)
            }
        }

        impl schemars::JsonSchema for $name {
            fn inline_schema() -> bool {
                true
            }

            fn schema_name() -> std::borrow::Cow<'static, str> {
                u32::schema_name()
            }

            fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
                u32::json_schema(generator)
            }
        }
    };
}

index!(
    /// Place of a camera among the cameras of a clip: source cameras first, then evaluation cameras.
    CameraIndex
);

index!(
    /// A frame of a clip, `0..frame_count()`. Every record, field, query and score counts frames like this.
    FrameIndex
);

index!(
    /// A frame of the episode that a clip was taken from, from 0 at the episode's first frame. Only ingest sees episodes;
    /// [`Clip::episode_frames`](crate::records::clip::Clip::episode_frames) says which frame of the clip shows which.
    EpisodeFrame
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_are_plain_numbers_outside() {
        let frames: Vec<FrameIndex> = FrameIndex::first(3).collect();
        assert_eq!(serde_json::to_string(&frames).unwrap(), "[0,1,2]");
        assert_eq!(serde_json::from_str::<Vec<FrameIndex>>("[0,1,2]").unwrap(), frames);
        assert_eq!(format!("{:>3}, {frames:?}", CameraIndex(7)), "  7, [0, 1, 2]");
        assert_eq!("12".parse::<EpisodeFrame>().unwrap().at(), 12);
        let schema = |of: schemars::Schema| of.to_value();
        assert_eq!(
            schema(schemars::schema_for!(Vec<FrameIndex>))["items"],
            schema(schemars::schema_for!(Vec<u32>))["items"]
        );
    }
}
