//! Small files that announce or unpack to much more: the memory that a command takes is bounded by the length of its input.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::io::Write as _;
use std::process::Command;

use crate::support::{ROGS, Workspace};

/// Runs the program with so much memory that ten times its input and 256 MiB fit; returns what it said. Address space is
/// more than memory: threads reserve stacks.
fn run(workspace: &Workspace, arguments: &[&str]) -> (Option<i32>, String) {
    let output = Command::new("sh")
        .args(["-c", "ulimit -v 900000; RAYON_NUM_THREADS=2 exec \"$0\" \"$@\"", ROGS])
        .args(arguments)
        .current_dir(workspace.path("."))
        .output()
        .unwrap();
    (
        output.status.code(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

#[track_caller]
fn refused(workspace: &Workspace, arguments: &[&str], word: &str) {
    let (code, said) = run(workspace, arguments);
    assert_eq!(code, Some(2), "{arguments:?}: {said}");
    assert!(said.contains(word), "{arguments:?}: {said}");
}

#[test]
fn images_that_announce_more_than_they_are_are_refused() {
    let workspace = Workspace::empty();
    let image = image::RgbImage::from_fn(64, 64, |x, y| image::Rgb([x as u8, y as u8, (x * y) as u8]));
    for (format, name) in [(image::ImageFormat::Jpeg, "a.jpg"), (image::ImageFormat::Png, "a.png")] {
        image.save_with_format(workspace.path(name), format).unwrap();
        assert_eq!(run(&workspace, &["metrics", name, name]).0, Some(0));
    }
    let mut bytes = std::fs::read(workspace.path("a.jpg")).unwrap();
    // The frame header: marker, length, precision, height, width.
    let frame = bytes.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap();
    bytes[frame + 5..frame + 9].copy_from_slice(&[62, 128, 62, 128]);
    std::fs::write(workspace.path("large.jpg"), bytes).unwrap();
    refused(&workspace, &["metrics", "large.jpg", "large.jpg"], "of memory");
    // The header chunk: length, name, width, height, five more bytes, checksum of all but the length.
    let mut bytes = std::fs::read(workspace.path("a.png")).unwrap();
    bytes[16..24].copy_from_slice(&[0, 0, 31, 64, 0, 0, 31, 64]);
    let crc = crc32fast::hash(&bytes[12..29]).to_be_bytes();
    bytes[29..33].copy_from_slice(&crc);
    std::fs::write(workspace.path("large.png"), bytes).unwrap();
    refused(&workspace, &["metrics", "large.png", "large.png"], "of memory");
    // Pixels of one value, which pack a thousand to one.
    let channel = vec![0.0_f32; 2100 * 2000];
    rogs_arrays::write_exr(&workspace.path("large.exr"), (2100, 2000), "Z", channel).unwrap();
    refused(&workspace, &["metrics", "large.exr", "large.exr"], "of memory");
}

#[test]
fn archives_that_unpack_to_much_more_are_refused() {
    let workspace = Workspace::empty();
    // A deflated member: blocks that repeat the zero before them, 258 at a time.
    let plain = 48_usize << 20;
    let header = format!(
        "{{'descr': '|u1', 'fortran_order': False, 'shape': ({}, 1024, 3), }}",
        (plain - 128) / 3072
    );
    let mut npy = b"\x93NUMPY\x01\0\x76\0".to_vec();
    npy.extend(format!("{header:<117}\n").bytes());
    npy.resize(128 + (plain - 128) / 3072 * 3072, 0);
    let packed = miniz_oxide::deflate::compress_to_vec(&npy, 6);
    let (crc, size) = (crc32fast::hash(&npy), npy.len() as u32);
    drop(npy);
    let mut common = vec![20, 0, 0, 0, 8, 0, 0, 0, 0x21, 0];
    common.extend(crc.to_le_bytes());
    common.extend((packed.len() as u32).to_le_bytes());
    common.extend(size.to_le_bytes());
    common.extend([7, 0, 0, 0]);
    let mut file = std::fs::File::create(workspace.path("bomb.npz")).unwrap();
    let mut out = b"PK\x03\x04".to_vec();
    out.extend(&common);
    out.extend(b"rgb.npy");
    out.extend(&packed);
    let directory = out.len() as u32;
    out.extend(b"PK\x01\x02\x14\0");
    out.extend(&common);
    out.extend([0; 14]);
    out.extend(b"rgb.npy");
    let length = out.len() as u32 - directory;
    out.extend(b"PK\x05\x06\0\0\0\0\x01\0\x01\0");
    out.extend(length.to_le_bytes());
    out.extend(directory.to_le_bytes());
    out.extend([0, 0]);
    file.write_all(&out).unwrap();
    refused(&workspace, &["metrics", "bomb.npz", "bomb.npz"], "numpy.savez");
}

#[test]
fn many_small_arrays_take_time_and_memory_in_proportion() {
    let workspace = Workspace::empty();
    let make = |count: usize| {
        let mut header = String::from("{");
        for number in 0..count {
            let (from, to) = (12 * number, 12 * number + 12);
            let comma = if number == 0 { "" } else { "," };
            header.push_str(&format!(
                "{comma}\"t{number}\":{{\"dtype\":\"F32\",\"shape\":[1,1,3],\"data_offsets\":[{from},{to}]}}"
            ));
        }
        header.push('}');
        let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
        bytes.extend(header.bytes());
        bytes.resize(bytes.len() + 12 * count, 0);
        std::fs::write(workspace.path("many.safetensors"), bytes).unwrap();
    };
    let seconds = |count: usize| {
        make(count);
        let begin = std::time::Instant::now();
        let file = rogs_arrays::ArrayFile::open(&workspace.path("many.safetensors")).unwrap();
        let names = file.names();
        let found = names.iter().filter(|name| file.find(&[name]).unwrap().is_some());
        assert_eq!(found.count(), count);
        begin.elapsed().as_secs_f64()
    };
    // Ten times as many: by squares it would be a hundred times as long.
    let few = (0..3).map(|_| seconds(2000)).fold(f64::MAX, f64::min);
    let many = (0..3).map(|_| seconds(20_000)).fold(f64::MAX, f64::min);
    assert!(many < 40.0 * few + 0.2, "{few} s and {many} s");
}

#[test]
fn tables_of_any_length_take_little_memory() {
    let workspace = Workspace::empty();
    workspace.write(
        "r.urdf",
        "<robot name=\"r\"><link name=\"a\"/><link name=\"b\"/><joint name=\"j\" type=\"revolute\"><parent link=\"a\"/>\
         <child link=\"b\"/><axis xyz=\"0 0 1\"/><limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint></robot>",
    );
    // Largest resident memory, bytes, looked at until the end.
    let peak = |count: usize| {
        workspace.write("j.csv", &format!("j\n{}", "0.1\n".repeat(count)));
        let mut child = Command::new(ROGS)
            .args(["fk", "r.urdf", "--joints", "j.csv"])
            .current_dir(workspace.path("."))
            .stdout(std::fs::File::create(workspace.path("poses.json")).unwrap())
            .spawn()
            .unwrap();
        let (place, mut most) = (format!("/proc/{}/status", child.id()), 0_u64);
        while child.try_wait().unwrap().is_none() {
            let status = std::fs::read_to_string(&place).unwrap_or_default();
            let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
            let kibibytes = line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<u64>().ok());
            most = most.max(1024 * kibibytes.unwrap_or(0));
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
        assert_eq!(child.wait().unwrap().code(), Some(0));
        let text = std::fs::read_to_string(workspace.path("poses.json")).unwrap();
        assert_eq!(text.matches("\"row\"").count(), count);
        assert!(text.starts_with("{\n  \"format\": \"rogs.fk/1\"") && text.ends_with("}\n  ]\n}\n"));
        most
    };
    // All rows and poses together would take 140 MB more.
    let (few, many) = (peak(1000), peak(60_000));
    assert!(many < few + (40 << 20), "{few} and {many} bytes");
    // A row that is wrong is found before anything is printed.
    workspace.write("j.csv", &format!("j\n{}x\n", "0.1\n".repeat(1000)));
    let output = workspace.rogs(&["fk", "r.urdf", "--joints", "j.csv"]);
    assert_eq!((output.status.code(), output.stdout.len()), (Some(2), 0));
    workspace.write("j.csv", &format!("j\n{}", "1".repeat(3 << 20)));
    refused(&workspace, &["fk", "r.urdf", "--joints", "j.csv"], "a line is longer");
}
