//! Pages of `egotac view`: which are answered, and what they can't do.

use std::fs;

use crate::client::View;
use crate::common::small_store;

#[test]
fn only_reading_requests_of_the_own_page_are_answered() {
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("small.zarr");
    small_store(&store);
    let view = View::start(&[store.to_str().unwrap(), "--labels-only"]);
    assert!(view.address.starts_with("127.0.0.1:"), "{}", view.address);
    let own = view.address.clone();
    for path in ["/", "/style.css", "/view.js", "/hands.js", "/chart.js", "/link.js", "/about", "/hands/0"] {
        let (status, body) = view.http("GET", path, &own);
        assert!(status == 200 && body.len() > 500, "{path}: {status} {body}");
        for method in ["POST", "PUT", "DELETE", "PATCH"] {
            assert_eq!(view.http(method, path, &own).0, 405, "{method} {path}");
        }
    }
    for path in ["/hands/1", "/../Cargo.toml", "/etc/passwd", "/hands/x"] {
        assert!((400..500).contains(&view.http("GET", path, &own).0), "{path}");
    }
    // A name that an attacker lets point at this machine, and a page of another server.
    assert_eq!(view.http("GET", "/about", "evil.example").0, 403);
    let refused = view.page(Some("http://evil.example")).map(|_| ()).unwrap_err().to_string();
    assert!(refused.contains("403"), "{refused}");
    assert!(view.page(Some(&format!("http://{own}"))).is_ok());
}

#[test]
fn a_page_beyond_the_sixteenth_is_refused_until_one_closes() {
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("small.zarr");
    small_store(&store);
    let view = View::start(&[store.to_str().unwrap(), "--labels-only"]);
    let mut pages: Vec<_> = (0..16).map(|_| view.page(None).unwrap()).collect();
    let refused = view.page(None).map(|_| ()).unwrap_err().to_string();
    assert!(refused.contains("503"), "{refused}");
    pages.pop();
    // The server hears of the closed connection a moment later.
    let again = (0..200).find_map(|_| {
        std::thread::sleep(std::time::Duration::from_millis(20));
        view.page(None).ok()
    });
    assert!(again.is_some());
}

#[test]
fn a_page_that_does_not_read_holds_back_no_other_and_costs_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("large.zarr");
    crate::common::store::write_store(&store, &[60], 0.04, |index| {
        let image = image::RgbImage::from_fn(640, 480, |x, y| {
            let noise = (x * 7919 + y * 104_729 + index as u32 * 31).wrapping_mul(2_654_435_761) >> 24;
            image::Rgb([noise as u8; 3])
        });
        (image, egotac::TactileField::zeros(egotac::Topology::EgotacHand1))
    });
    let view = View::start(&[store.to_str().unwrap(), "--labels-only"]);
    let mut reader = view.page(None).unwrap();
    for frame in 0..60 {
        assert_eq!(reader.ask(&format!("{{\"source\": 0, \"frame\": {frame}}}")).head["frame"], frame);
    }
    let before = view.peak_kb();
    let mut silent: Vec<_> = (0..8).map(|_| view.page(None).unwrap()).collect();
    for round in 0..100 {
        silent.iter_mut().for_each(|page| page.send(&format!("{{\"source\": 0, \"frame\": {}}}", round % 60)));
    }
    for frame in 0..60 {
        assert_eq!(reader.ask(&format!("{{\"source\": 0, \"frame\": {frame}}}")).head["frame"], frame);
    }
    // 800 answers of 0.2 MB at least would be 160 MB.
    let grown = view.peak_kb() - before;
    assert!(grown < 60_000, "{grown} kB");
}

#[test]
fn sources_that_can_t_be_shown_are_refused_with_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(at("no.mp4"), b"nothing").unwrap();
    fs::create_dir(at("empty")).unwrap();
    for (source, word) in [("no.mp4", "no.mp4"), ("empty", "holds nothing"), ("absent", "there is no such file")] {
        crate::common::refused(&["view", &at(source)], word);
    }
    crate::common::refused(&["view", "neither"], "there is no such file");
    let store = at("small.zarr");
    small_store(store.as_ref());
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    crate::common::refused(&["view", &store, "--labels-only", "--listen", &address], "choose another with --listen");
}
