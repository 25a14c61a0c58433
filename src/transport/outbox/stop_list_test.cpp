// SPDX-License-Identifier: GPL-2.0-or-later
#include <Ice/Ice.h>
#include <gtest/gtest.h>
#include <axon/stop_list.hpp>

namespace axon::transport {
namespace {

using Axon::CommUtil::StopList;

class StopLists : public testing::Test {
  protected:
    /// What is read of the list, and of the word after it.
    std::pair<std::vector<std::string>, std::string> sent(const std::vector<std::string>& names) {
        Ice::OutputStream out(ice_.communicator());
        out.writeAll(StopList(names), std::string("after"));
        std::pair<std::vector<std::string>, std::string> got;
        Ice::InputStream in(ice_.communicator(), out.finished());
        StopList list;
        in.readAll(list, got.second);
        got.first = std::move(list.names);
        return got;
    }
    Ice::CommunicatorHolder ice_{Ice::InitializationData{}};
};

TEST_F(StopLists, AListIsReadAsItWasWritten) {
    const std::vector<std::string> names{"e1", "", std::string(300, 'x')};
    EXPECT_EQ(sent(names).first, names);
    EXPECT_EQ(sent(names).second, "after");
    EXPECT_TRUE(sent({}).first.empty());
}

TEST_F(StopLists, OfALongListOnlyTheBeginningIsKeptAndWhatFollowsIsReadAllTheSame) {
    std::vector<std::string> names(500'000, "name");
    names[0] = "first";
    const auto [read, after] = sent(names);
    ASSERT_EQ(read.size(), StopList::kMost + 1) << "one more, so that the server sees that it is too long";
    EXPECT_EQ(read.front(), "first");
    EXPECT_EQ(after, "after");
}

TEST_F(StopLists, ANumberOfNamesThatTheMessageCannotHoldIsRefused) {
    // A sequence's size of more than 254 is 255 and four bytes.
    const std::vector<Ice::Byte> bytes{255, 255, 255, 255, 127, 0, 0};
    Ice::InputStream in(ice_.communicator(), bytes);
    StopList list;
    EXPECT_THROW(in.read(list), Ice::UnmarshalOutOfBoundsException);
    EXPECT_LE(list.names.size(), bytes.size()) << "no more than the bytes that there are";
}

TEST_F(StopLists, ANameThatIsLongerThanTheRestIsRefusedAlsoWhereItIsSkipped) {
    Ice::OutputStream out(ice_.communicator());
    out.write(StopList(std::vector<std::string>(StopList::kMost + 2, "n")));
    auto bytes = out.finished().first == nullptr
                     ? std::vector<Ice::Byte>{}
                     : std::vector<Ice::Byte>(out.finished().first, out.finished().second);
    bytes[bytes.size() - 2] = 200;  // the length of the last one
    Ice::InputStream in(ice_.communicator(), bytes);
    StopList list;
    EXPECT_THROW(in.read(list), Ice::UnmarshalOutOfBoundsException);
}

}  // namespace
}  // namespace axon::transport
