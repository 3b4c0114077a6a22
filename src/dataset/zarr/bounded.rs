//! Decompression of chunks that never writes more than the chunk's shape demands.
//!
//! The library's own codecs decode whatever a chunk holds, so that a few kilobytes can fill the memory. The codecs here take
//! their place for every array that this process opens.

use std::any::Any;
use std::borrow::Cow;
use std::io::Read;
use std::sync::{Arc, Once};

use flate2::bufread::{GzDecoder, ZlibDecoder};
use zarrs::array::codec::api::{
    CodecRuntimePluginV2, CodecRuntimePluginV3, PartialDecoderCapability, PartialEncoderCapability, register_codec_v2,
    register_codec_v3,
};
use zarrs::array::codec::{BloscCodec, GzipCodec, ZlibCodec, ZstdCodec, blosc_decompress_bytes, blosc_validate};
use zarrs::array::{
    ArrayBytesRaw, BytesPartialDecoderTraits, BytesRepresentation, BytesToBytesCodecTraits, Codec, CodecError,
    CodecMetadataOptions, CodecOptions, CodecTraits, CodecTraitsV2, CodecTraitsV3, RecommendedConcurrency,
};
use zarrs::metadata::Configuration;
use zarrs::plugin::{ExtensionAliasesV2, ExtensionAliasesV3, ExtensionName, ZarrVersion};

use crate::file::limits;

/// Size of the header of a Blosc buffer, bytes.
const BLOSC_HEADER: usize = 16;

/// Puts the bounded codecs in place of the library's.
pub(super) fn register() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        replace::<BloscCodec>(Kind::Blosc);
        replace::<GzipCodec>(Kind::Gzip);
        replace::<ZlibCodec>(Kind::Zlib);
        replace::<ZstdCodec>(Kind::Zstd);
    });
}

fn replace<C: CodecTraitsV2 + CodecTraitsV3 + ExtensionAliasesV2 + ExtensionAliasesV3 + 'static>(kind: Kind) {
    register_codec_v2(CodecRuntimePluginV2::new(C::matches_name_v2, move |metadata| {
        Ok(bounded(<C as CodecTraitsV2>::create(metadata)?, kind))
    }));
    register_codec_v3(CodecRuntimePluginV3::new(C::matches_name_v3, move |metadata| {
        Ok(bounded(<C as CodecTraitsV3>::create(metadata)?, kind))
    }));
}

fn bounded(codec: Codec, kind: Kind) -> Codec {
    match codec {
        Codec::BytesToBytes(inner) => Codec::BytesToBytes(Arc::new(Bounded { inner, kind })),
        other => other,
    }
}

/// Format of compressed bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Blosc,
    Gzip,
    Zlib,
    Zstd,
}

impl Kind {
    /// Decompresses at most `most` bytes.
    fn decode(self, encoded: &[u8], most: u64) -> Result<Vec<u8>, CodecError> {
        let mut decoded = Vec::new();
        let count = match self {
            Self::Blosc => {
                check_blosc(encoded, most)?;
                let size = blosc_validate(encoded).ok_or("expected a Blosc buffer, got another or a damaged one")?;
                return blosc_decompress_bytes(encoded, size, 1).map_err(|e| CodecError::Other(e.to_string()));
            }
            // This refuses what exceeds the capacity.
            Self::Zstd => return Ok(zstd::bulk::decompress(encoded, usize::try_from(most).unwrap_or(usize::MAX))?),
            Self::Gzip => GzDecoder::new(encoded).take(most.saturating_add(1)).read_to_end(&mut decoded)?,
            Self::Zlib => ZlibDecoder::new(encoded).take(most.saturating_add(1)).read_to_end(&mut decoded)?,
        };
        match count as u64 <= most {
            true => Ok(decoded),
            false => Err(too_large(most, "more")),
        }
    }
}

fn too_large(most: u64, got: impl std::fmt::Display) -> CodecError {
    CodecError::Other(format!("expected a chunk of at most {most} bytes, as its shape demands, got {got}"))
}

/// Checks the size in the header of a Blosc buffer, to which the library's decoder holds itself.
fn check_blosc(encoded: &[u8], most: u64) -> Result<(), CodecError> {
    let size = encoded.get(4..8).and_then(|size| Some(u32::from_le_bytes(size.try_into().ok()?)));
    match size.filter(|_| encoded.len() >= BLOSC_HEADER) {
        Some(size) if u64::from(size) <= most => Ok(()),
        Some(size) => Err(too_large(most, size)),
        None => Err(CodecError::Other(format!("expected a Blosc buffer, got {} bytes", encoded.len()))),
    }
}

/// A codec that decodes at most as many bytes as its place in the array demands.
#[derive(Debug)]
struct Bounded {
    inner: Arc<dyn BytesToBytesCodecTraits>,
    kind: Kind,
}

/// Returns the largest number of decoded bytes.
fn most(decoded: &BytesRepresentation) -> u64 {
    decoded.size().unwrap_or(u64::MAX).min(limits::CHUNK.value())
}

impl ExtensionName for Bounded {
    fn name(&self, version: ZarrVersion) -> Option<Cow<'static, str>> {
        self.inner.name(version)
    }
}

impl CodecTraits for Bounded {
    fn as_any(&self) -> &dyn Any {
        self
    }

    fn configuration(&self, version: ZarrVersion, options: &CodecMetadataOptions) -> Option<Configuration> {
        self.inner.configuration(version, options)
    }

    fn partial_decoder_capability(&self) -> PartialDecoderCapability {
        self.inner.partial_decoder_capability()
    }

    fn partial_encoder_capability(&self) -> PartialEncoderCapability {
        self.inner.partial_encoder_capability()
    }
}

impl BytesToBytesCodecTraits for Bounded {
    fn into_dyn(self: Arc<Self>) -> Arc<dyn BytesToBytesCodecTraits> {
        self
    }

    fn recommended_concurrency(&self, decoded: &BytesRepresentation) -> Result<RecommendedConcurrency, CodecError> {
        self.inner.recommended_concurrency(decoded)
    }

    fn encoded_representation(&self, decoded: &BytesRepresentation) -> BytesRepresentation {
        self.inner.encoded_representation(decoded)
    }

    fn encode<'a>(&self, value: ArrayBytesRaw<'a>, options: &CodecOptions) -> Result<ArrayBytesRaw<'a>, CodecError> {
        self.inner.encode(value, options)
    }

    fn decode<'a>(
        &self,
        encoded: ArrayBytesRaw<'a>,
        decoded: &BytesRepresentation,
        _: &CodecOptions,
    ) -> Result<ArrayBytesRaw<'a>, CodecError> {
        Ok(Cow::Owned(self.kind.decode(&encoded, most(decoded))?))
    }

    fn partial_decoder(
        self: Arc<Self>,
        input: Arc<dyn BytesPartialDecoderTraits>,
        decoded: &BytesRepresentation,
        options: &CodecOptions,
    ) -> Result<Arc<dyn BytesPartialDecoderTraits>, CodecError> {
        // An absent chunk stays absent.
        let Some(encoded) = input.decode(options)?.map(Cow::into_owned) else { return Ok(input) };
        if self.kind == Kind::Blosc {
            check_blosc(&encoded, most(decoded))?;
            // The library's decoder takes single blocks from the buffer.
            return self.inner.clone().partial_decoder(Arc::new(encoded), decoded, options);
        }
        Ok(Arc::new(self.kind.decode(&encoded, most(decoded))?))
    }
}
