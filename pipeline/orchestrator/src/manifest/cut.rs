//! How many clips are cut from an episode, and where.

use std::borrow::Cow;
use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{Episode, Input};

/// How many clips are cut from an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ClipCount {
    /// All that fit.
    All,
    /// At most so many.
    AtMost(u32),
}

/// What a table says of the clips of its episodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Cut {
    /// How many.
    pub(crate) clips: ClipCount,
    /// From the start of one to the start of the next, episode frames.
    pub(crate) stride: Option<u32>,
    /// Where the first starts, episode frame.
    pub(crate) start: u32,
    /// Clips are named by where they start: there may be several.
    pub(crate) several: bool,
}

impl Cut {
    /// `None`: one clip, where the stage starts it.
    fn of(clips: Option<ClipCount>, stride: Option<u32>, start: Option<u32>) -> Option<Self> {
        if clips.is_none() && start.is_none() {
            return None;
        }
        Some(Self {
            clips: clips.unwrap_or(ClipCount::AtMost(1)),
            stride,
            start: start.unwrap_or(0),
            several: clips.is_some(),
        })
    }

    /// Where the clips of `span` episode frames start in an episode of `frames` frames, ascending. An episode that has no
    /// room for one, or whose length is not known, gets one all the same: it fails and says why.
    pub(crate) fn starts(self, span: u64, frames: Option<u64>) -> Vec<u32> {
        /// Most clips of one episode.
        const MOST: usize = 1 << 20;
        let stride = self.stride.map_or(span, u64::from).max(1);
        let most = match self.clips {
            ClipCount::All => MOST,
            ClipCount::AtMost(most) => most as usize,
        };
        let fits = |start: &u64| frames.is_some_and(|frames| start + span <= frames);
        let starts = (0..)
            .map(|index| u64::from(self.start) + index * stride)
            .take_while(fits)
            .take(most);
        let starts: Vec<u32> = starts.filter_map(|start| u32::try_from(start).ok()).collect();
        if starts.is_empty() { vec![self.start] } else { starts }
    }
}

impl Input {
    /// What it says of the clips of its episodes.
    pub(crate) fn cut(&self) -> Option<Cut> {
        Cut::of(self.clips, self.stride, self.start)
    }
}

impl Episode {
    /// What it says of its clips.
    pub(crate) fn cut(&self) -> Option<Cut> {
        Cut::of(self.clips, self.stride, self.start)
    }
}

impl Serialize for ClipCount {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::All => serializer.serialize_str("all"),
            Self::AtMost(most) => serializer.serialize_u32(*most),
        }
    }
}

impl<'de> Deserialize<'de> for ClipCount {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl serde::de::Visitor<'_> for Visitor {
            type Value = ClipCount;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("\"all\" or a number of clips from 1")
            }

            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<ClipCount, E> {
                match text {
                    "all" => Ok(ClipCount::All),
                    other => Err(E::invalid_value(serde::de::Unexpected::Str(other), &self)),
                }
            }

            fn visit_i64<E: serde::de::Error>(self, number: i64) -> Result<ClipCount, E> {
                let most = u32::try_from(number).ok().filter(|&most| most > 0);
                let wrong = || E::invalid_value(serde::de::Unexpected::Signed(number), &self);
                most.map(ClipCount::AtMost).ok_or_else(wrong)
            }

            fn visit_u64<E: serde::de::Error>(self, number: u64) -> Result<ClipCount, E> {
                self.visit_i64(i64::try_from(number).unwrap_or(i64::MAX))
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

impl JsonSchema for ClipCount {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "ClipCount".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "oneOf": [{ "const": "all" }, { "type": "integer", "minimum": 1 }] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(clips: Option<ClipCount>, stride: Option<u32>, start: Option<u32>) -> Cut {
        Cut::of(clips, stride, start).unwrap()
    }

    #[test]
    fn clips_start_where_they_fit() {
        let all = cut(Some(ClipCount::All), None, None);
        assert_eq!(all.starts(17, Some(51)), [0, 17, 34]);
        assert_eq!(all.starts(17, Some(50)), [0, 17]);
        let dense = cut(Some(ClipCount::All), Some(8), Some(7));
        assert_eq!(dense.starts(17, Some(40)), [7, 15, 23]);
        let two = cut(Some(ClipCount::AtMost(2)), Some(8), None);
        assert_eq!(two.starts(17, Some(400)), [0, 8]);
        assert_eq!(cut(None, None, Some(3)).starts(17, Some(400)), [3]);
        assert_eq!(Cut::of(None, Some(5), None), None);
    }

    #[test]
    fn an_episode_without_room_or_length_gets_one_clip() {
        let all = cut(Some(ClipCount::All), None, Some(4));
        assert_eq!((all.starts(17, Some(20)), all.starts(17, None)), (vec![4], vec![4]));
    }

    #[test]
    fn counts_are_all_or_a_number_from_one() {
        let read = |text: &str| serde_json::from_str::<ClipCount>(text).map_err(|error| error.to_string());
        assert_eq!(read("\"all\""), Ok(ClipCount::All));
        assert_eq!(read("3"), Ok(ClipCount::AtMost(3)));
        for wrong in ["0", "-1", "\"every\"", "1.5"] {
            let error = read(wrong).unwrap_err();
            assert!(
                error.contains("expected \"all\" or a number of clips from 1"),
                "{error}"
            );
        }
    }
}
