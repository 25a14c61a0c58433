// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <string>
#include <utility>
#include <vector>

namespace Axon::CommUtil {

/// The entities of one stop of several, as C++ reads them from a message: at most one more than a server
/// takes, so that the thread of the stops makes no strings of a list of half a million names. The rest is
/// skipped.
struct StopList {
    static constexpr std::size_t kMost = 8192;

    StopList() = default;
    explicit StopList(std::vector<std::string> its_names) : names(std::move(its_names)) {}

    std::vector<std::string> names;  ///< when read: never more than kMost + 1
};

}  // namespace Axon::CommUtil

namespace Ice {

template <>
struct StreamableTraits<Axon::CommUtil::StopList> {
    static const StreamHelperCategory helper = StreamHelperCategoryUnknown;
    static const int minWireSize = 1;
    static const bool fixedLength = false;
};

template <>
struct StreamHelper<Axon::CommUtil::StopList, StreamHelperCategoryUnknown> {
    template <class Stream>
    static void write(Stream* stream, const Axon::CommUtil::StopList& list) {
        stream->write(list.names);
    }
    template <class Stream>
    static void read(Stream* stream, Axon::CommUtil::StopList& list) {
        const Int size = stream->readAndCheckSeqSize(1);
        list.names.clear();
        for (Int i = 0; i < size; ++i) {
            if (list.names.size() <= Axon::CommUtil::StopList::kMost) {
                stream->read(list.names.emplace_back());
            } else {
                stream->skip(static_cast<typename Stream::size_type>(stream->readSize()));
            }
        }
    }
};

}  // namespace Ice
