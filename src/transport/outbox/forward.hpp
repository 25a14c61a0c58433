// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <exception>
#include <functional>
#include <type_traits>
#include <utility>

#include "transport/ice/convert.hpp"

namespace axon::transport {

// What every asynchronous operation of a proxy takes last, in this order.
using Answered = std::function<void()>;
using Failed = std::function<void(std::exception_ptr)>;
using Sent = std::function<void(bool)>;

/// A `somethingAsync` of a proxy, in the form that is told how the call ends.
template <class Prx, class... Parameters>
using Operation = std::function<void()> (Prx::*)(Parameters..., Answered, Failed, Sent, const Ice::Context&);

/// How an operation takes an argument of this type.
template <class T>
using Parameter = std::conditional_t<std::is_class_v<T>, const T&, T>;

/// forward<Prx>(&Prx::somethingAsync, more...) is the `call` of ProxySender::send that makes this one
/// call. The operation takes, in this order, of the following what its Slice declares: `more` before the
/// head; the head; `more` behind it; the bytes. The overloads are these forms; the compiler takes the one
/// that fits. `more` is copied.
template <class Prx, class... More>
auto forward(Operation<Prx, Parameter<More>..., const ice::Header&, const ByteRange&> operation,
             More... more) {
    return [operation, ... more = std::move(more)](Prx& prx, const ice::Header& head, const ByteRange& bytes,
                                                   Answered answered, Failed failed, Sent sent) {
        (prx.*operation)(more..., head, bytes, std::move(answered), std::move(failed), std::move(sent),
                         Ice::noExplicitContext);
    };
}
template <class Prx, class... More>
auto forward(Operation<Prx, const ice::Header&, Parameter<More>...> operation, More... more) {
    return [operation, ... more = std::move(more)](Prx& prx, const ice::Header& head, const ByteRange&,
                                                   Answered answered, Failed failed, Sent sent) {
        (prx.*operation)(head, more..., std::move(answered), std::move(failed), std::move(sent),
                         Ice::noExplicitContext);
    };
}
template <class Prx, class... More>
auto forward(Operation<Prx, Parameter<More>..., const ByteRange&> operation, More... more) {
    return [operation, ... more = std::move(more)](Prx& prx, const ice::Header&, const ByteRange& bytes,
                                                   Answered answered, Failed failed, Sent sent) {
        (prx.*operation)(more..., bytes, std::move(answered), std::move(failed), std::move(sent),
                         Ice::noExplicitContext);
    };
}
/// For the form of send() without a head.
template <class Prx, class... More>
auto forward(Operation<Prx, Parameter<More>...> operation, More... more) {
    return [operation, ... more = std::move(more)](Prx& prx, Answered answered, Failed failed, Sent sent) {
        (prx.*operation)(more..., std::move(answered), std::move(failed), std::move(sent),
                         Ice::noExplicitContext);
    };
}

}  // namespace axon::transport
