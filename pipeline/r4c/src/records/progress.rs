//! How a computation's progress lies in its container.

use rogs_schemas::records::progress::Progress;
use rogs_schemas::{ClipId, SchemaId};
use serde::{Deserialize, Serialize};

use super::arrays::{self, ArrayHead};
use crate::error::Result;
use crate::reader::Reader;
use crate::record::Record;
use crate::stream::{Codec, Dtype, Frame, StreamSpec, Unit};
use crate::writer::Writer;

const ARRAYS: StreamSpec = StreamSpec {
    name: "arrays",
    dtype: Dtype::F32,
    unit: Unit::One,
    frame: Frame::None,
    // Written often and read once at most.
    codec: Codec::Raw,
    fill: "",
};

#[derive(Serialize, Deserialize)]
struct Head {
    clip_id: ClipId,
    counters: Vec<(String, u64)>,
    arrays: Vec<ArrayHead>,
}

impl Record for Progress {
    const SCHEMA: SchemaId = SchemaId {
        name: "rogs.progress",
        major: 1,
        minor: 0,
    };

    fn encode(&self, writer: &mut Writer) -> Result<()> {
        self.check().map_err(|what| writer.inconsistent(what))?;
        let head = Head {
            clip_id: self.clip_id.clone(),
            counters: self.counters.clone(),
            arrays: arrays::heads(&self.arrays),
        };
        writer.value("progress", &head)?;
        arrays::write(writer, &ARRAYS, &self.arrays)
    }

    fn decode(reader: &Reader) -> Result<Self> {
        let head: Head = reader.value("progress")?;
        let progress = Self {
            clip_id: head.clip_id,
            counters: head.counters,
            arrays: arrays::read(reader, &ARRAYS, head.arrays)?,
        };
        progress.check().map_err(|what| reader.inconsistent(what))?;
        Ok(progress)
    }
}
