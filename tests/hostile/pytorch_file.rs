//! PyTorch archives: every layout of tensors is read as PyTorch means it, and a hostile one is refused.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use crate::common::refused;
use egotac::model::checkpoint::read_tensors;
use tempfile::TempDir;
use zip::CompressionMethod;
use zip::write::SimpleFileOptions;

/// Appends opcodes of Python's pickle format, protocol 2, as PyTorch writes them.
#[derive(Default)]
struct Pickle(Vec<u8>);

impl Pickle {
    fn new() -> Self {
        Self(b"\x80\x02".to_vec())
    }

    fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend(bytes);
        self
    }

    fn text(self, text: &str) -> Self {
        self.raw(b"X").raw(&(text.len() as u32).to_le_bytes()).raw(text.as_bytes())
    }

    fn int(self, number: i64) -> Self {
        match i32::try_from(number) {
            Ok(number) => self.raw(b"J").raw(&number.to_le_bytes()),
            Err(_) => self.raw(b"\x8a\x08").raw(&number.to_le_bytes()),
        }
    }

    fn tuple(self, numbers: &[i64]) -> Self {
        numbers.iter().fold(self.raw(b"("), |pickle, number| pickle.int(*number)).raw(b"t")
    }

    /// Appends a tensor: type and number of elements of its storage, first element, size, stride.
    fn tensor(self, kind: &str, key: &str, length: i64, start: i64, size: &[i64], stride: &[i64]) -> Self {
        self.raw(b"ctorch._utils\n_rebuild_tensor_v2\n((")
            .text("storage")
            .raw(format!("ctorch\n{kind}\n").as_bytes())
            .text(key)
            .text("cpu")
            .int(length)
            .raw(b"tQ")
            .int(start)
            .tuple(size)
            .tuple(stride)
            .raw(b"\x89ccollections\nOrderedDict\n)RtR")
    }
}

struct Files(TempDir);

impl Files {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn write(&self, name: &str, pickle: &[u8], storages: &[(&str, Vec<u8>)]) -> PathBuf {
        self.write_as(name, pickle, storages, CompressionMethod::Stored)
    }

    fn write_as(&self, name: &str, pickle: &[u8], storages: &[(&str, Vec<u8>)], how: CompressionMethod) -> PathBuf {
        let path = self.0.path().join(name);
        let mut zip = zip::ZipWriter::new(fs::File::create(&path).unwrap());
        let options = SimpleFileOptions::default().compression_method(how);
        let mut add = |name: String, bytes: &[u8]| {
            zip.start_file(name, options).unwrap();
            zip.write_all(bytes).unwrap();
        };
        add("net/data.pkl".into(), pickle);
        add("net/byteorder".into(), b"little");
        storages.iter().for_each(|(key, bytes)| add(format!("net/data/{key}"), bytes));
        zip.finish().unwrap();
        path
    }
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

#[test]
fn types_strides_and_parameters_are_read_as_pytorch_means_them() {
    let files = Files::new();
    let six = [0.5, 1.5, 2.5, 3.5, 4.5, 5.5];
    let pickle = Pickle::new().raw(b"ccollections\nOrderedDict\n)R(");
    let pickle = pickle.text("plain").tensor("FloatStorage", "0", 6, 0, &[2, 3], &[3, 1]);
    let pickle = pickle.text("transposed").tensor("FloatStorage", "0", 6, 0, &[3, 2], &[1, 3]);
    let pickle = pickle.text("every_second").tensor("FloatStorage", "0", 6, 1, &[3], &[2]);
    let pickle = pickle.text("scalar").tensor("FloatStorage", "0", 6, 5, &[], &[]);
    let pickle = pickle.text("empty").tensor("FloatStorage", "0", 6, 0, &[0, 3], &[3, 1]);
    let pickle = pickle.text("half").tensor("HalfStorage", "1", 2, 0, &[2], &[1]);
    let pickle = pickle.text("bf16").tensor("BFloat16Storage", "2", 1, 0, &[1], &[1]);
    let pickle = pickle.text("double").tensor("DoubleStorage", "3", 1, 0, &[1], &[1]);
    let pickle = pickle.text("long").tensor("LongStorage", "4", 1, 0, &[1], &[1]);
    // torch.nn.Parameter: _rebuild_parameter(tensor, requires_grad, hooks).
    let pickle = pickle.text("parameter").raw(b"ctorch._utils\n_rebuild_parameter\n(");
    let pickle = pickle.tensor("FloatStorage", "0", 6, 0, &[1], &[1]).raw(b"\x88ccollections\nOrderedDict\n)RtR");
    let pickle = pickle.text("epoch").int(3).raw(b"u}").text("_metadata").raw(b"ccollections\nOrderedDict\n)Rsb.");
    let f16 = |value: f32| half::f16::from_f32(value).to_le_bytes();
    let storages = [
        ("0", floats(&six)),
        ("1", [f16(1.25), f16(-2.0)].concat()),
        ("2", half::bf16::from_f32(0.5).to_le_bytes().to_vec()),
        ("3", 0.1f64.to_le_bytes().to_vec()),
        ("4", (-7i64).to_le_bytes().to_vec()),
    ];
    let top = read_tensors(&files.write("top.pt", &pickle.0, &storages)).unwrap();
    let values = |name: &str| (top[name].dims().to_vec(), top[name].flatten_all().unwrap().to_vec1::<f32>().unwrap());
    assert_eq!(values("plain"), (vec![2, 3], six.to_vec()));
    assert_eq!(values("transposed"), (vec![3, 2], vec![0.5, 3.5, 1.5, 4.5, 2.5, 5.5]));
    assert_eq!(values("every_second"), (vec![3], vec![1.5, 3.5, 5.5]));
    assert_eq!(values("scalar"), (vec![], vec![5.5]));
    assert_eq!(values("empty"), (vec![0, 3], vec![]));
    assert_eq!(values("half"), (vec![2], vec![1.25, -2.0]));
    assert_eq!(values("bf16"), (vec![1], vec![0.5]));
    assert_eq!(values("double"), (vec![1], vec![0.1]));
    assert_eq!(values("long"), (vec![1], vec![-7.0]));
    assert_eq!(values("parameter"), (vec![1], vec![0.5]));
    assert_eq!(top.len(), 10, "{:?}", top.keys());
}

#[test]
fn tensors_under_a_key_are_found_beside_other_objects() {
    let files = Files::new();
    for key in ["state_dict", "model", "model_state_dict"] {
        let pickle = Pickle::new().raw(b"}(").text("args").raw(b"cargparse\nNamespace\n)\x81}").text("lr");
        let pickle = pickle.raw(b"G\x3f\xf0\0\0\0\0\0\0sb").text(key).raw(b"}").text("w");
        let pickle = pickle.tensor("FloatStorage", "0", 2, 0, &[2], &[1]).raw(b"su.");
        let path = files.write("nested.pt", &pickle.0, &[("0", floats(&[1.0, 2.0]))]);
        let tensors = read_tensors(&path).unwrap();
        assert_eq!(tensors["w"].to_vec1::<f32>().unwrap(), [1.0, 2.0]);
    }
}

#[test]
fn hostile_archives_are_refused() {
    let files = Files::new();
    let table = files.0.path().join("table.yaml");
    let geometry = "vision_width: 48, vision_depth: 2, vision_heads: 3, width: 32, depth: 2, heads: 4, image: 56, patch: 14, \
                    pretrain_image: 70, horizon: 3, predict: 2";
    let text = format!("config: {{ {geometry} }}\nsidecar: {{ name: x, topology: mano, fps: 30 }}\nsame: true\n");
    fs::write(&table, text).unwrap();
    let import = |path: &Path, word: &str| {
        let out = files.0.path().join("out.safetensors");
        let [weights, mapping, out] = [path, &table, &out].map(|path| path.to_str().unwrap());
        refused(&["model", "import", "--checkpoint", weights, "--mapping", mapping, "--out", out], word);
    };
    let huge = 1i64 << 40;
    let one = |length, start, size: &[i64], stride: &[i64]| {
        Pickle::new().raw(b"}").text("w").tensor("FloatStorage", "0", length, start, size, stride).raw(b"s.").0
    };
    let inside = "inside its storage";
    for (name, pickle, word) in [
        ("length.pt", one(1 << 31, 0, &[1 << 31], &[1]), "expected a storage of 2147483648 numbers"),
        ("overflow.pt", one(i64::MAX, 0, &[4], &[1]), "expected a storage of"),
        ("size.pt", one(4, 0, &[huge, huge], &[1, 1]), inside),
        ("expanded.pt", one(4, 0, &[1 << 31], &[0]), inside),
        ("stride.pt", one(4, 0, &[2], &[huge]), inside),
        ("start.pt", one(4, i64::MAX, &[1], &[1]), inside),
        ("negative.pt", one(4, 0, &[-1], &[1]), "length -1"),
        ("ranks.pt", one(4, 0, &[1, 1], &[1]), inside),
        ("many.pt", one(4, 0, &[1; 60], &[1; 60]), "at most 32 dimensions"),
        ("empty.pt", b".".to_vec(), "a value is missing from the stack"),
        ("reduce.pt", b"R.".to_vec(), "a value is missing from the stack"),
        (
            "arguments.pt",
            Pickle::new().raw(b"}").text("w").raw(b"ctorch._utils\n_rebuild_tensor_v2\n)Rs.").0,
            "without entry",
        ),
        ("deep.pt", [&b"("[..], &b"]".repeat(500_000), &b"a".repeat(499_999), b"t."].concat(), "has no tensors"),
        ("text.pt", [&b"X"[..], &u32::MAX.to_le_bytes(), b"."].concat(), "ends in the middle"),
        ("names.pt", Pickle::new().raw(b"cposix\nsystem\n.").0, "`posix.system`"),
        ("copies.pt", [&b"}"[..], &b"2".repeat(12 << 20)].concat(), "bytes of memory"),
    ] {
        import(&files.write(name, &pickle, &[("0", vec![0; 16])]), word);
    }
    // One storage of 1 MB under so many names that they need 64 GB.
    let mut ties = Pickle::new().raw(b"}(");
    for i in 0..20_000 {
        let tensor = ties.text(&format!("w{i}"));
        ties = tensor.tensor("FloatStorage", "0", 1 << 18, 0, &[1 << 18], &[1]);
    }
    let path = files.write("ties.pt", &ties.raw(b"u.").0, &[("0", vec![0; 1 << 20])]);
    import(&path, "eight times the size of the file");
    // 64 MB of zeros, compressed.
    let bomb = vec![0; 64 << 20];
    let path =
        files.write_as("bomb.pt", &one(1 << 24, 0, &[1 << 24], &[1]), &[("0", bomb)], CompressionMethod::Deflated);
    import(&path, "neither compressed nor encrypted");
    let mut bytes =
        fs::read(files.write("spoilt.pt", &one(4, 0, &[4], &[1]), &[("0", b"0123456789abcdef".to_vec())])).unwrap();
    let place = bytes.windows(16).position(|part| part == b"0123456789abcdef").unwrap();
    bytes[place] ^= 1;
    fs::write(files.0.path().join("spoilt.pt"), bytes).unwrap();
    import(&files.0.path().join("spoilt.pt"), "checksum");
}
