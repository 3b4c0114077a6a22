//! Live sources: a camera, through a stand-in for ffmpeg that has a test picture in place of a device.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::time::Duration;

use crate::client::View;

#[test]
fn a_camera_is_read_as_v4l2_and_a_slow_page_learns_how_many_images_it_missed() {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("ffmpeg");
    let heard = folder.path().join("arguments");
    let real = std::env::split_paths(&std::env::var_os("PATH").unwrap())
        .map(|path| path.join("ffmpeg"))
        .find(|path| path.is_file());
    let script = format!(
        "#!/bin/sh\necho \"$@\" > {}\nexec {} -nostdin -v error -re -f lavfi -i testsrc=size=320x240:rate=20 -f image2pipe -c:v ppm -pix_fmt rgb24 -\n",
        heard.display(),
        real.unwrap().display()
    );
    fs::write(&program, script).unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", folder.path().display(), std::env::var("PATH").unwrap());
    // A character device, as a camera is; the stand-in never opens it.
    let view = View::start_with(&["/dev/null", "--size", "320x240"], Some(&path));
    let mut page = view.page(None).unwrap();
    let sequence = |answer: &crate::client::Answer| answer.head["sequence"].as_u64().unwrap();
    let first = page.ask(r#"{"source": 0, "after": 0}"#);
    assert_eq!((first.dropped, &first.head["size"]), (0, &serde_json::json!([320, 240])));
    let arguments = fs::read_to_string(&heard).unwrap();
    assert!(arguments.contains("-f v4l2 -video_size 320x240 -i /dev/null"), "{arguments}");
    let (mut last, mut missed) = (sequence(&first), 0);
    for round in 0..4 {
        // Images go on while the page is busy.
        std::thread::sleep(Duration::from_millis(if round % 2 == 0 { 600 } else { 0 }));
        let answer = page.ask(&format!("{{\"source\": 0, \"after\": {last}}}"));
        assert!(sequence(&answer) > last);
        missed += sequence(&answer) - last - 1;
        assert_eq!(u64::from(answer.dropped), missed);
        last = sequence(&answer);
    }
    assert!(missed > 0);
}
