//! `rogs fk`: forward kinematics of a table of joint values.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use rogs_robot::RobotModel;
use rogs_robot::fk_json::FkTable;
use rogs_robot::limits::LimitTally;

use crate::output;

/// Computes link poses of a robot for every row of a table of joint values.
///
/// Prints JSON with one item a row; its `links` maps each link's name to its row-major 4x4 pose in the base
/// link's frame (metres).
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// URDF of the robot.
    robot: PathBuf,
    /// CSV file: a header with joint names, then one row of values (radians, metres) a state. Mimic joints follow.
    #[arg(long, value_name = "CSV")]
    joints: PathBuf,
    /// Frame in which poses are given; by default the root link of the robot.
    #[arg(long, value_name = "LINK")]
    base_link: Option<String>,
    /// Print JSON (the only form there is; accepted so that every command takes it).
    #[arg(long)]
    json: bool,
}

/// Longest line of a table, bytes.
const LONGEST_LINE: u64 = 1 << 20;

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let _ = args.json;
    let mut model = RobotModel::load(&args.robot)?;
    if let Some(base_link) = &args.base_link {
        model = model.with_base_link(base_link)?;
    }
    for note in &model.notes {
        output::warning(&format!("robot `{}`: {note}", args.robot.display()));
    }
    let place = || format!("in `{}`", args.joints.display());
    // Neither the table nor the poses need fit into memory: the rows are read twice, the first time to see that nothing is
    // wrong with any of them.
    let mut reader = open(&args.joints)?;
    let table = FkTable::new(&model, &fields(reader.headers().with_context(place)?)).with_context(place)?;
    let mut tally = LimitTally::new(&model);
    let (mut record, mut row) = (csv::StringRecord::new(), 0);
    while reader.read_record(&mut record).with_context(place)? {
        tally.add(&table.check(row, &fields(&record)).with_context(place)?);
        row += 1;
    }
    for warning in tally.warnings("rows", "this table takes radians") {
        output::warning(&format!("`{}`: {warning}", args.joints.display()));
    }
    let mut reader = open(&args.joints)?;
    let rows = reader.records().enumerate().map(|(row, record)| {
        let record = record.with_context(place)?;
        table.row(row, &fields(&record)).with_context(place)
    });
    output::json_items(rows)?;
    Ok(ExitCode::SUCCESS)
}

fn fields(record: &csv::StringRecord) -> Vec<&str> {
    record.iter().collect()
}

fn open(path: &Path) -> anyhow::Result<csv::Reader<Lines<File>>> {
    let file = rogs_files::open(path).with_context(|| format!("reading `{}`", path.display()))?;
    let lines = Lines {
        inner: file,
        left: LONGEST_LINE,
    };
    Ok(csv::ReaderBuilder::new().flexible(true).from_reader(lines))
}

/// A reader that refuses lines without an end.
struct Lines<R> {
    inner: R,
    /// Bytes that the line in hand may still have.
    left: u64,
}

impl<R: Read> Read for Lines<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.inner.read(buffer)?;
        let after_end = buffer[..count].iter().rev().take_while(|&&byte| byte != b'\n').count();
        let left = if after_end < count { LONGEST_LINE } else { self.left };
        self.left = left.checked_sub(after_end as u64).ok_or_else(|| {
            std::io::Error::new(
                ErrorKind::InvalidData,
                format!("a line is longer than {LONGEST_LINE} bytes"),
            )
        })?;
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_without_an_end_are_refused_and_many_lines_are_not() {
        let read = |text: &[u8]| {
            let mut lines = Lines {
                inner: text,
                left: LONGEST_LINE,
            };
            std::io::copy(&mut lines, &mut std::io::sink())
        };
        assert_eq!(read("0.25\n".repeat(1 << 20).as_bytes()).unwrap(), 5 << 20);
        let error = read(&vec![b','; 2 << 20]).unwrap_err();
        assert!(error.to_string().contains("a line is longer"), "{error}");
    }
}
